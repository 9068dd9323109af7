"""The arm as its files describe it and as MuJoCo simulates it: drives, robot, payload, plant."""
