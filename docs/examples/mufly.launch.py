"""Launch the simulated helicopter and RViz: ``ros2 launch mufly.launch.py mission:=box-on-leg``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> LaunchDescription:
    """Return the processes: mufly, and RViz in the frame of the map."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("mission", default_value="demonstration", description="mission: name or file"),
            DeclareLaunchArgument("vehicle", default_value="mufly-1.1", description="vehicle: name or file"),
            ExecuteProcess(
                cmd=[
                    "mufly",
                    "link",
                    LaunchConfiguration("mission"),
                    "--vehicle",
                    LaunchConfiguration("vehicle"),
                    "--ros",
                ],
                output="screen",
                sigterm_timeout="15",
            ),
            ExecuteProcess(cmd=["rviz2", "-f", "map"], output="screen"),
        ]
    )
