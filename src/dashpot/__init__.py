"""dashpot: virtual passive control for torque-sensed robot joints."""
