"""Where does it see itself? Visual SLAM over a floor: tracking, keyframes, loops, and data sets to try it on."""

from mufly.slam.calibration import Calibration, board_pictures, calibrate
from mufly.slam.datasets import PHASE_SIGMA, Path3, Teller, frames, path_of, rounds
from mufly.slam.evaluation import Evaluation, evaluate, read_truth
from mufly.slam.frame import Frame, Telling
from mufly.slam.mapping import Keyframe, Map
from mufly.slam.process import Counts, Sight, Sketch, SlamProcess, features_of, sketched
from mufly.slam.readers import Source, open_live, open_pictures, read_telemetry, standing_at
from mufly.slam.system import TOO_NEAR, Answer, Slam
from mufly.slam.trajectory import Trajectory, draw, gathered, read_trajectory, run
from mufly.slam.vision import opencv
from mufly.slam.writers import LAYOUTS, camera_toml, write_dataset

__all__ = [
    "LAYOUTS",
    "PHASE_SIGMA",
    "TOO_NEAR",
    "Answer",
    "Calibration",
    "Counts",
    "Evaluation",
    "Frame",
    "Keyframe",
    "Map",
    "Path3",
    "Sight",
    "Sketch",
    "Slam",
    "SlamProcess",
    "Source",
    "Teller",
    "Telling",
    "Trajectory",
    "board_pictures",
    "calibrate",
    "camera_toml",
    "draw",
    "evaluate",
    "features_of",
    "frames",
    "gathered",
    "open_live",
    "open_pictures",
    "opencv",
    "path_of",
    "read_telemetry",
    "read_trajectory",
    "read_truth",
    "rounds",
    "run",
    "sketched",
    "standing_at",
    "write_dataset",
]
