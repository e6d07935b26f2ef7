"""Makes the pictures of the campaigns in systems.md from the built systems, and prints what they measure.

python docs/figures_campaign.py
"""

from __future__ import annotations

from figures import IMAGES
from rich.console import Console
from rich.table import Table

from cosim.campaign.campaign import campaign
from cosim.campaign.picture import write_picture
from cosim.campaign.report import counts, summary

VARY = {"plant.start.x1": (-1.0, 1.0), "plant.start.x2": (-1.0, 1.0), "plant.sensor.seed": None}

if __name__ == "__main__":
    for name in ("gong_example_5", "gong_example_5_ukf"):
        made = campaign(f"systems/{name}.ssp", f"results/{name}_campaign", runs=100, vary=VARY)
        write_picture(made, IMAGES / f"{name}_campaign.svg")
        found = summary(made)
        printed = Table(*found.columns, title=name)
        for row in found.rows:
            printed.add_row(*row)
        Console().print(printed, counts(made))
