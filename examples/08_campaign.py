"""A campaign from Python: payloads and drive errors sampled, judged, and one scenario run again."""

import tempfile
from pathlib import Path

from dashpot.campaign.execute import execute
from dashpot.campaign.judge import judge
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, create, open_dataset
from dashpot.simulation.simulate import run

SPEC = """
robot = "fr3"
controller = "fr3"
duration = 1.0
sample = "sobol"
count = 4
[axes]
payload = { low = 0.0, high = 3.0 }
drive.rotor_inertia = { low = 0.85, high = 1.15, each_joint = true }
[requirements]
error_max_deg = { max = 10.0 }
"""

campaign = Campaign(Spec.parse(SPEC, None))
campaign.check()
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "campaign.zarr"
    create(path, campaign)
    store = Store(path, campaign)
    execute(campaign, store, workers=0)  # here; None: one process per core
    store.close()
    with open_dataset(path) as dataset:
        print(dataset["error_max"].max("joint").to_series())
        for verdict in judge(campaign.spec, dataset):
            print(f"{verdict.requirement.words}: {'met' if verdict.holds else 'not met'}")
recording = run(campaign.scenario(2))  # the same bits as above
print(f"scenario 2: {campaign.values(2)['payload']:.2f} kg, {len(recording.time)} ticks")
