"""One table of sensors: what it knows, every room takes up; which other files name a sensor, and why."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import mufly

SOURCE = Path(mufly.__file__).parent
NAMES = {
    "magnetometer": "magnetometer magnetic_field READING_MAGNETIC_FIELD MagnetometerSensor MagnetometerParameters",
    "pressure": "pressure READING_PRESSURE PressureSensor PressureSensorParameters",
    "sonar": "sonar ground_distance READING_SONAR UltrasonicSensor SonarParameters",
    "position_fix": "position_fix READING_POSITION_FIX PositionFixSensor PositionFixParameters",
}
"""Table, reading, index in the filter, model and parameters of each."""
ROOMS = (
    "cli", "compiled", "estimate", "files", "firmware", "flight", "link", "quantities", "results", "sensors", "station",
    "vehicle",
)  # fmt: skip
"""Where a name is that of a sensor: elsewhere a pressure is that of the air on a bench, a sonar a data set's file."""
OF_EVERY_SENSOR = {
    "quantities/sensor_table.py": "its row",
    "sensors/sensor_suite.py": "its class",
    "vehicle/sensor_schema.py": "its parameters",
    "estimate/filter/filter_records.py": "its noise in the filter's settings",
    "estimate/filter/measurements/fusion.py": "its measurement model",
}
_PROOF = {"firmware/proof/proof_flights.py": "its faults in the flights by which C is proved equal"}
OF_ONE_SENSOR = {
    "magnetometer": {
        "sensors/magnetometer.py": "its model",
        **_PROOF,
        "vehicle/plausibility.py": "its field is compared with the Earth's",
    },
    "pressure": {
        "sensors/pressure.py": "its model",
        **_PROOF,
    },
    "sonar": {
        "sensors/sonar.py": "its model",
        **_PROOF,
        "estimate/filter/ekf_step.py": "its least range, learned on the floor, begins as that of the file",
        "estimate/filter/filter_horizon.py": "the terrain is uncertain while its cone passes over an edge",
        "estimate/filter/filter_inputs.py": "it tells whether the vehicle has left the floor",
        "estimate/filter/measurements/fix_fusion.py": "its height is compared with that of the fix",
        "estimate/filter/measurements/scalar_fusion.py": "it hears second surfaces, so a large innovation is no fault",
        "estimate/kalman_estimator.py": "lost periods repeat the rows before its own: those of the inertial unit",
        "estimate/filter/measurements/sensor_checks.py": "it hears second surfaces, so more rejections are no alarm",
        "flight/fixes/camera_sensor.py": "pictures tell no place on the floor, where the sonar reads its least",
        "flight/simulated_flight.py": "the same: the camera rests there",
        "vehicle/vehicle_schema.py": "its place is above the floor on which the legs stand",
        "vehicle/plausibility.py": "its beam passes no rotor, and it reaches down to lift-off",
        "cli/vehicle.py": "the check states its range on the floor",
    },
    "position_fix": {
        "sensors/position_fix.py": "its model",
        "estimate/filter/measurements/fix_fusion.py": "its measurement model, whose biases are estimated",
        "estimate/filter/ekf_step.py": "the heading is aligned by it; its biases step when it is fused",
        "estimate/inertial_log.py": "positions of a log are fused as fixes",
        "estimate/kalman_estimator.py": "it may come with a covariance",
        "estimate/nees.py": "the consistency of an estimate is judged by its innovations",
        "estimate/filter/measurements/sensor_checks.py": "a fault is that of one component; its heading may repeat",
        "flight/fixes/camera_sensor.py": "stands in for it",
        "flight/fixes/external_fixes.py": "stands in for it",
        "flight/simulated_flight.py": "is told which sensor rests",
        "flight/estimator_health.py": "without it and without walls nothing tells where it is",
        "flight/record/estimate_pictures.py": "is drawn beside the estimate",
        "flight/record/foreign_log.py": "positions of a log are recorded as fixes",
    },
}
"""Files that name a sensor beside those of :data:`OF_EVERY_SENSOR`, and why its row does not do."""


def words_of(path: Path) -> Iterator[str]:
    """Names in the code of a file, and texts without spaces: prose and docstrings may name what they like."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name) | ast.alias(name=name):
                yield name
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.keyword(arg=str(name)):
                yield name
            case ast.Constant(value=str(text)) if node not in docstrings and " " not in text:
                yield text


@pytest.fixture(scope="module")
def words() -> dict[str, set[str]]:
    files = [p for p in SOURCE.rglob("*.py") if p.parent == SOURCE or p.relative_to(SOURCE).parts[0] in ROOMS]
    return {p.relative_to(SOURCE).as_posix(): set(words_of(p)) for p in files}


@pytest.mark.parametrize("sensor", NAMES)
def test_a_file_that_names_a_sensor_has_a_reason(sensor: str, words: dict[str, set[str]]) -> None:
    named = re.compile(rf"(sensors\.|measured_)?({'|'.join(NAMES[sensor].split())})([._].*)?")
    found = {file for file, there in words.items() if any(map(named.fullmatch, there))}
    assert found == OF_EVERY_SENSOR.keys() | OF_ONE_SENSOR[sensor].keys()


def test_a_row_of_the_table_is_all_that_faults_link_recording_and_page_need() -> None:
    script = Path(__file__).with_name("made_up_sensor.py")
    told = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True, timeout=300)
    assert json.loads(told.stdout) == {
        "fault": ["pitot_tube", 2.0],
        "reason": "differs from the estimate by 1.5 m/s",
        "failure": "pitot",
        "status bit": True,
        "test ratio": ["airspeed", "airspeed"],
        "message": ["rejected", 34],
        "recorded": [[3.0, 0.0, -1.0], 0.45, True, [0.1, 0.2, 0.3]],
        "recorded innovation": 7.3,
        "page": [["airspeed", "rejected", 7.3, ""]],
    }
