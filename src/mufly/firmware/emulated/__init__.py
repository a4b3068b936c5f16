"""Fly the loop of a board on this machine, or its image in QEMU, with the simulation as its hardware."""

from mufly.firmware.emulated.board_flight import BoardFlightResult, fly_board, make_board
from mufly.firmware.emulated.boards import EmulatedBoard, HostBoard
from mufly.firmware.emulated.image_build import build_image

__all__ = ["BoardFlightResult", "EmulatedBoard", "HostBoard", "build_image", "fly_board", "make_board"]
