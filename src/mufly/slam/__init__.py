"""Visual SLAM over a floor: tracking, keyframes, loop closure, and data sets for tests."""

from mufly.slam.calibration.lens_calibration import LensCalibration, calibrate_lens, list_board_pictures
from mufly.slam.camera_frame import CameraFrame, FrameEstimate
from mufly.slam.datasets.dataset_readers import (
    FrameSource,
    make_estimate_function_from_height,
    open_live_pictures,
    open_picture_source,
    read_telemetry_interpolator,
)
from mufly.slam.datasets.dataset_writers import WRITABLE_DATASET_LAYOUTS, format_camera_toml, write_dataset
from mufly.slam.datasets.picture_overlap import require_picture_overlap
from mufly.slam.datasets.synthetic_datasets import (
    PHASE_SIGMA_RAD,
    FrameEstimateSimulator,
    VehiclePath,
    make_square_path,
    path_from_recording,
    render_frames,
)
from mufly.slam.image_tools import import_opencv
from mufly.slam.keyframe_map import FloorMap, Keyframe
from mufly.slam.slam_process import (
    MapView,
    PictureCounts,
    SlamProcess,
    TrackedPicture,
    find_distorted_inlier_pixels,
    make_map_view,
)
from mufly.slam.slam_system import TOO_NEAR_REASON, SlamSystem, TrackingResult
from mufly.slam.slam_trajectory import (
    SlamSummary,
    SlamTrajectory,
    collect_results,
    plot_trajectory,
    read_trajectory,
    run_slam,
)
from mufly.slam.trajectory_evaluation import TrajectoryEvaluation, evaluate_trajectory, read_truth_trajectory

__all__ = [
    "PHASE_SIGMA_RAD",
    "TOO_NEAR_REASON",
    "WRITABLE_DATASET_LAYOUTS",
    "CameraFrame",
    "FloorMap",
    "FrameEstimate",
    "FrameEstimateSimulator",
    "FrameSource",
    "Keyframe",
    "LensCalibration",
    "MapView",
    "PictureCounts",
    "SlamProcess",
    "SlamSummary",
    "SlamSystem",
    "SlamTrajectory",
    "TrackedPicture",
    "TrackingResult",
    "TrajectoryEvaluation",
    "VehiclePath",
    "calibrate_lens",
    "collect_results",
    "evaluate_trajectory",
    "find_distorted_inlier_pixels",
    "format_camera_toml",
    "import_opencv",
    "list_board_pictures",
    "make_estimate_function_from_height",
    "make_map_view",
    "make_square_path",
    "open_live_pictures",
    "open_picture_source",
    "path_from_recording",
    "plot_trajectory",
    "read_telemetry_interpolator",
    "read_trajectory",
    "read_truth_trajectory",
    "render_frames",
    "require_picture_overlap",
    "run_slam",
    "write_dataset",
]
