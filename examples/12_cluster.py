"""A campaign on a Dask cluster (extra `campaign`): workers simulate, this process writes.

The cluster here is two processes on this machine; where a scheduler runs elsewhere, take its address.
"""

import tempfile
from pathlib import Path

from distributed import LocalCluster

from dashpot.campaign.cluster import connected
from dashpot.campaign.execute import execute
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, create, open_dataset

SPEC = """
robot = "k807"
controller = "k807-wrist"
duration = 0.5
chunk = 2
[axes]
payload = [0.0, 2.0, 4.5]
trajectory = [1, 2]
"""

if __name__ == "__main__":  # processes of the cluster import this file
    campaign = Campaign(Spec.parse(SPEC, None))
    campaign.check()
    with tempfile.TemporaryDirectory() as folder, LocalCluster(2, dashboard_address=None) as cluster:
        path = Path(folder) / "campaign.zarr"
        create(path, campaign)
        store = Store(path, campaign)
        with connected(cluster.scheduler_address) as client:
            execute(campaign, store, client=client)
        store.close()
        with open_dataset(path) as dataset:
            print(dataset["error_rms"].max("joint").to_series())
