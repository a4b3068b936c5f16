"""The node of ROS 2, with a stock subscriber in a second process."""

import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.flight import FlightRecorder, RequestAnswer, make_flight_row_layout
from mufly.vehicle import load_vehicle

PEER = """
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, LaserScan
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node("peer")
found = {}
for name, kind in {"/odom": Odometry, "/imu/data_raw": Imu, "/scan": LaserScan}.items():
    node.create_subscription(kind, name, lambda message, name=name: found.setdefault(name, message), 10)
while len(found) < 3:
    rclpy.spin_once(node, timeout_sec=0.1)
odom = found["/odom"]
p, q = odom.pose.pose.position, odom.pose.pose.orientation
print(odom.header.frame_id, odom.child_frame_id, p.x, p.y, p.z, q.w, found["/imu/data_raw"].linear_acceleration.z)
print(len(found["/scan"].ranges))
client = node.create_client(Trigger, "/take_off")
assert client.wait_for_service(10)
future = client.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=10)
print(future.result().success, future.result().message)
goal, speed = node.create_publisher(PoseStamped, "/goal_pose", 10), node.create_publisher(Twist, "/cmd_vel", 10)
pose = PoseStamped()
pose.header.frame_id = "map"
pose.pose.position.x, pose.pose.position.z, pose.pose.orientation.w = 2.0, 1.5, 1.0
twist = Twist()
twist.linear.x, twist.linear.y, twist.angular.z = 0.3, 0.1, 0.2
for _ in range(20):
    goal.publish(pose)
    speed.publish(twist)
    rclpy.spin_once(node, timeout_sec=0.1)
"""


def test_without_ros_the_remedy_is_named(monkeypatch):
    from mufly.bridges.ros_node import import_rclpy

    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(InputError, match="pip install 'mufly\\[ros\\]'"):
        import_rclpy()


def test_a_stock_subscriber_reads_and_commands_the_flight():
    pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'mufly[ros]'")
    from mufly.bridges.ros_node import RosViewConfig

    layout = make_flight_row_layout(8, sensors=True)
    recorder, events, calls = FlightRecorder(None, layout=layout), [], []
    status = SimpleNamespace(offboard_active=True)
    autopilot = SimpleNamespace(
        status=status,
        take_off=lambda: RequestAnswer(False, "the battery is low"),
        go_to=lambda place, heading: calls.append(("go_to", place, heading)) or RequestAnswer(True),
        send_set_point=lambda s: calls.append(("set", s)) or RequestAnswer(True),
    )
    flight = SimpleNamespace(
        recorder=recorder, records_only_truth=False, vehicle=load_vehicle("mufly-1.1"), autopilot=autopilot,
        log_event=lambda text, level="info": events.append(text),
        estimate=SimpleNamespace(attitude=np.array([0.0, 0.0, np.pi / 2]), position=np.array([0.0, 0.0, -1.0])),
    )  # fmt: skip
    view = RosViewConfig("mufly_test").open_view(flight)
    row = np.ones(layout.column_count)
    columns = layout.column_slices
    row[columns["estimated_position"]] = (3.0, 4.0, -1.0)
    row[columns["estimated_attitude"]] = (0.0, 0.0, np.pi / 2)
    row[columns["measured_acceleration"]] = (0.0, 0.0, -9.81)
    peer = subprocess.Popen([sys.executable, "-c", PEER], stdout=subprocess.PIPE, text=True)
    try:
        until, k = time.monotonic() + 60.0, 0
        while peer.poll() is None and time.monotonic() < until:
            row[0], k = 0.005 * k, k + 1
            recorder.append_row(row, "hover")
            view.serve_requests()
            time.sleep(0.005)
        assert peer.returncode == 0
        said = peer.stdout.read().split()
    finally:
        peer.kill()
        view.close()
    assert said[:2] == ["map", "base_link"]
    assert np.allclose([float(v) for v in said[2:7]], [4.0, 3.0, 1.0, 1.0, 9.81])
    assert said[7:] == ["8", "False", "the", "battery", "is", "low"]
    assert any("15 topics" in e or "16 topics" in e for e in events)
    _, place, heading = next(c for c in calls if c[0] == "go_to")
    assert (place, heading) == ((0.0, 2.0, -1.5), pytest.approx(np.pi / 2))
    _, point = next(c for c in calls if c[0] == "set")
    # The nose looks east: ahead is east, left is north, a turn to the left has a negative rate.
    assert np.allclose(point.velocity_m_s, (0.1, 0.3, 0.0))
    assert point.yaw_rate_rad_s == pytest.approx(-0.2)
