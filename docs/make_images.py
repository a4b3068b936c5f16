"""Draw the pictures of the demonstration flight anew: ``python docs/make_images.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mufly
from mufly.flight import draw_flight_pictures, fly_mission
from mufly.mission import load_mission

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    vehicle, mission = mufly.load_vehicle("mufly-1.1"), load_mission("demonstration")
    dataset = fly_mission(vehicle, mission, controller=mufly.control.design_flight_controller(vehicle))
    points = [w.position_m for w in mission.waypoint]
    with tempfile.TemporaryDirectory() as folder:
        for picture in draw_flight_pictures(dataset, folder, waypoints=points, world=mission.world):
            if picture.stem in ("track", "history"):
                (IMAGES / picture.name).write_bytes(picture.read_bytes())


if __name__ == "__main__":
    main()
