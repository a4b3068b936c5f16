"""Bags of ROS 2: frames, covariances and stamps by the standards, and what comes back."""

import math

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.logs import (
    FlightEvent,
    RangeSensorGeometry,
    detect_log_format,
    make_flight_row_layout,
    read_log,
    read_raw_log,
    rows_to_dataset,
    write_log,
    write_rosbag2,
)
from mufly.logs.ros.ros_messages import ROS_TOPICS, attitude_to_ros, body_frd_to_flu, ned_to_enu
from mufly.rotations import body_to_ned_matrices, quaternions_from_euler

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'mufly[rosbag]'")
START_NS = 1_790_000_000_123_456_789
COUNT = 40


def make_flight(sensors=True):
    """Return a recording of random numbers, with sonar, ring and fixes in every fourth row only."""
    random = np.random.default_rng(5)
    layout = make_flight_row_layout(8, sensors=sensors)
    rows = random.uniform(0.1, 1.0, (COUNT, layout.column_count))
    rows[:, 0] = 0.005 * np.arange(COUNT)
    columns = layout.column_slices
    for name, part in columns.items():
        if name.endswith("_attitude"):
            rows[:, part] = random.uniform(-1.0, 1.0, (COUNT, 3)) * (3.0, 1.4, 3.0)
        if name.startswith("measured_") and name.endswith("_valid"):
            rows[:, part] = 1.0
        if name.startswith("measured_") and name.endswith("_time"):
            rows[:, part] = rows[:, :1] - 0.0025
    if sensors:
        seldom = [n for n in columns if any(w in n for w in ("_ground_distance", "_ranges", "_position_fix"))]
        for name in (n for n in seldom if n.startswith("measured_")):
            rows[np.arange(COUNT) % 4 != 0, columns[name]] = np.nan
        rows[4, columns["measured_ranges_valid"]] = 0.0
        for name in ("measured_position", "measured_velocity", "measured_attitude"):
            rows[:, columns[name]] = np.nan
    states = ["init"] * 10 + ["hover"] * (COUNT - 10)
    events = [FlightEvent(0.05, "hover", "it hovers", "warning")]
    attributes = {"start_time_ns": START_NS, "vehicle": "mufly-1.1"}
    return rows_to_dataset(rows, states, layout, attributes=attributes, events=events)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    flight = make_flight()
    path = tmp_path_factory.mktemp("bag") / "flight.rosbag2"
    limits = RangeSensorGeometry(0.5, 0.02, 3.0, math.radians(30.0), 0.1, 4.0)
    write_rosbag2(flight, path, limits=limits, pictures=[(0.1, b"\xff\xd8jpeg")])
    return flight, path


def read_messages(path, topic):
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:  # by the definitions inside the bag alone
        return [
            (arrival, reader.deserialize(data, connection.msgtype))
            for connection, arrival, data in reader.messages()
            if connection.topic == topic
        ]


def test_frames_follow_rep_103():
    """T R F with T from N-E-D to east-north-up and F from forward-left-up, by matrices."""
    assert ned_to_enu(np.array([[1.0, 2.0, 3.0]])).tolist() == [[2.0, 1.0, -3.0]]
    assert body_frd_to_flu(np.array([[1.0, 2.0, 3.0]])).tolist() == [[1.0, -2.0, -3.0]]
    attitude = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 3))
    to_enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    expected = to_enu @ body_to_ned_matrices(attitude) @ np.diag([1, -1, -1])
    found = attitude_to_ros(attitude)
    assert np.allclose(body_to_ned_matrices(found), expected, atol=1e-14)
    assert np.allclose(attitude_to_ros(found), attitude, atol=1e-15)
    east = attitude_to_ros(np.array([[0.0, 0.0, math.pi / 2]]))  # a nose to the east is yaw zero
    assert np.allclose(quaternions_from_euler(east), [[1.0, 0.0, 0.0, 0.0]])


def test_odometry_holds_frames_stamps_and_covariances(bag):
    flight, path = bag
    messages = read_messages(path, "/odom")
    assert len(messages) == COUNT
    k = 7
    arrival, message = messages[k]
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    assert stamp == arrival == START_NS + 35_000_000
    north, east, down = flight.estimated_position.values[k]
    place = message.pose.pose.position
    assert (place.x, place.y, place.z) == (east, north, -down)
    turn = body_to_ned_matrices(flight.estimated_attitude.values[k : k + 1])[0]
    velocity = turn.T @ flight.estimated_velocity.values[k] * (1, -1, -1)
    speed = message.twist.twist.linear
    assert np.allclose((speed.x, speed.y, speed.z), velocity, atol=1e-15)
    pose = message.pose.covariance.reshape(6, 6)
    sigma_n, sigma_e, sigma_d = flight.estimated_position_sigma.values[k]
    assert np.allclose(pose.diagonal()[:3], (sigma_e**2, sigma_n**2, sigma_d**2))
    assert np.allclose(pose.diagonal()[3:], flight.estimated_attitude_sigma.values[k] ** 2)
    assert np.count_nonzero(pose) == 6
    twist = message.twist.covariance.reshape(6, 6)
    flip = np.diag([1.0, -1.0, -1.0])
    expected = flip @ turn.T @ np.diag(flight.estimated_velocity_sigma.values[k] ** 2) @ turn @ flip
    assert np.allclose(twist[:3, :3], expected, atol=1e-15)
    assert np.allclose(twist.diagonal()[3:], flight.estimated_rates_sigma.values[k] ** 2)


def test_imu_ranges_battery_and_pictures(bag):
    flight, path = bag
    _, imu = read_messages(path, "/imu/data_raw")[3]
    assert imu.orientation_covariance[0] == -1.0
    force, rates = flight.measured_acceleration.values[3], flight.measured_rates.values[3]
    assert (imu.linear_acceleration.x, imu.linear_acceleration.z) == (force[0], -force[2])
    assert (imu.angular_velocity.y, imu.angular_velocity.z) == (-rates[1], -rates[2])
    sonar = read_messages(path, "/range/ground")
    assert len(sonar) == COUNT // 4
    arrival, first = sonar[1]
    stamp = first.header.stamp.sec * 1_000_000_000 + first.header.stamp.nanosec
    assert (arrival - START_NS, stamp - START_NS) == (20_000_000, 17_500_000)  # arrival, and time of measurement
    assert (first.radiation_type, round(first.field_of_view, 6), first.max_range) == (0, 0.5, 3.0)
    scans = read_messages(path, "/scan")
    assert len(scans) == COUNT // 4 - 1  # one is invalid
    _, scan = scans[0]
    ranges = flight.measured_ranges.values[0].astype(np.float32)
    # Beam 0 looks 30 degrees to the right, beam 1 another 45 degrees: the scan counts to the left.
    angles = scan.angle_min + scan.angle_increment * np.arange(8)
    beams = -(math.radians(30.0) + math.pi / 4 * np.arange(8))
    for angle, distance in zip(angles, scan.ranges, strict=True):
        beam = int(np.argmin(np.abs(np.angle(np.exp(1j * (angle - beams))))))
        assert distance == ranges[beam]
    _, battery = read_messages(path, "/battery_state")[0]
    assert battery.current == -np.float32(flight.battery_current.values[0])
    assert math.isnan(battery.capacity)
    ((arrival, picture),) = read_messages(path, "/camera/image/compressed")
    assert (arrival - START_NS, picture.format, bytes(picture.data)) == (100_000_000, "jpeg", b"\xff\xd8jpeg")
    (_, tf), *_ = read_messages(path, "/tf")
    assert (tf.transforms[0].header.frame_id, tf.transforms[0].child_frame_id) == ("map", "base_link")
    ((_, event),) = read_messages(path, "/rosout")
    assert (event.level, event.msg) == (30, "it hovers")


def test_signals_come_back(bag):
    flight, path = bag
    assert detect_log_format(path) == detect_log_format(next(path.glob("*.mcap"))) == "rosbag2"
    raw = read_raw_log(path)
    assert raw.start_time.startswith("2026-09")
    for topic, table in raw.items():
        for field in table.units:
            name, _, label = field.partition(".")
            values = flight[name].values.reshape(COUNT, -1)
            labels = [""] if flight[name].ndim == 1 else [str(v) for v in flight[flight[name].dims[1]].values]
            expected = values[:, labels.index(label)]
            source = next(t for t in ROS_TOPICS if t.name == topic)
            index = np.flatnonzero(np.isfinite(flight[source.signal].values.reshape(COUNT, -1)).all(axis=1))
            if source.valid_signal:
                index = index[flight[source.valid_signal].values[index] > 0.5]
            single = topic in ("/scan", "/obstacles/scan", "/range/ground", "/battery_state")  # float32 in ROS
            assert np.allclose(table.fields[field], expected[index], rtol=1e-7 if single else 1e-13, atol=1e-14), field
    back = read_log(path, signals=["estimated_*", "mission_state"])
    assert np.allclose(back.time, flight.time)
    assert np.allclose(back.estimated_velocity_sigma, flight.estimated_velocity_sigma)
    assert back.mission_state.values.tolist() == flight.mission_state.values.tolist()


def test_bag_of_another_program_counts_as_measured(tmp_path):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, name = store.types, "geometry_msgs/msg/PoseStamped"
    with Writer(tmp_path / "mocap", version=8) as writer:  # SQLite, as Humble writes it
        connection = writer.add_connection("/mocap/pose", name, typestore=store)
        for k in range(5):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](100 + k, 0), "world")
            place = types["geometry_msgs/msg/Point"](1.0 + k, 2.0, 3.0)
            level = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
            message = types[name](header, types["geometry_msgs/msg/Pose"](place, level))
            writer.write(connection, (100 + k) * 10**9, store.serialize_cdr(message, name))
    back = read_log(tmp_path / "mocap")
    assert back.measured_position.values[2].tolist() == [2.0, 3.0, -3.0]
    assert back.measured_attitude.values[2, 2] == pytest.approx(math.pi / 2)
    assert back.time.values.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_messages_name_the_remedy(tmp_path):
    flight = make_flight(sensors=False)
    with pytest.raises(InputError, match="no signal has a ROS topic"):
        write_log(flight[["wind"]], tmp_path / "a.rosbag2")
    (tmp_path / "b.rosbag2").mkdir()
    with pytest.raises(InputError, match="is no bag"):
        write_log(flight, tmp_path / "b.rosbag2")
    path = write_log(flight, tmp_path / "c.rosbag2")
    assert "/measured/odom" in read_raw_log(path)
    write_log(flight, path)  # replaced
    next(path.glob("*.mcap")).write_bytes(b"x")
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_raw_log(path)
    assert not list(tmp_path.glob(".*"))
