"""Options of live views: Foxglove and ROS 2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from mufly.cli.options import define_option

if TYPE_CHECKING:
    from mufly.bridges.foxglove_live import FoxgloveViewConfig
    from mufly.flight.record.live_view import LiveViewConfig

FoxgloveOption = Annotated[
    str,
    define_option(
        "--foxglove [HOST:]PORT",
        "Address at which Foxglove shows the running flight (docs/how-to/use-with-ros.md). Foxglove's default port is "
        "8765.",
    ),
]
RosOption = Annotated[
    bool,
    define_option(
        "--ros", "Run a node of ROS 2 that publishes the flight and takes commands (docs/how-to/use-with-ros.md)."
    ),
]


def make_live_views(foxglove: str, ros: bool) -> tuple[LiveViewConfig, ...]:
    """Return the live views that the options request: Foxglove, ROS 2, both or none.

    Raises
    ------
    InputError
        If an address is wrong or a package is missing.
    """
    views: list[LiveViewConfig] = []
    if foxglove:
        views.append(make_foxglove_view(foxglove))
    if ros:
        from mufly.bridges.ros_node import RosViewConfig, import_rclpy

        import_rclpy()
        views.append(RosViewConfig())
    return tuple(views)


def make_foxglove_view(address: str) -> FoxgloveViewConfig:
    """Return the view for Foxglove at an address.

    Raises
    ------
    InputError
        If the address is wrong or foxglove-sdk is missing.
    """
    from mufly.bridges.foxglove_live import FoxgloveViewConfig, import_foxglove
    from mufly.camera import parse_address

    import_foxglove()
    return FoxgloveViewConfig(*parse_address(address, "--foxglove"))
