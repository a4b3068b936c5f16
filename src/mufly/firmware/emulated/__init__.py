"""Fly a board's on-board program with a simulated vehicle, as a library on this machine or as an image in QEMU."""

from mufly.firmware.emulated.board_flight import BoardFlightResult, fly_board, make_board
from mufly.firmware.emulated.boards import EmulatedBoard, HostBoard
from mufly.firmware.emulated.image_build import build_board_image

__all__ = ["BoardFlightResult", "EmulatedBoard", "HostBoard", "build_board_image", "fly_board", "make_board"]
