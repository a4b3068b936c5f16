"""Boards that the simulation drives: the loop's code on this machine, and the image on a processor emulated by QEMU.

A period has two halves. The first takes the readings and computes the estimate; the second takes the command and
computes the inputs of the actuators. After each half the whole memory of the board is known here.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.firmware.emulated.board_memory import MemoryLayout

EMULATED_MACHINE = "mps2-an386"
"""Board with a Cortex-M4F that QEMU emulates."""
FLASH_SECTOR_WORDS = 4096
"""Words of 32 bits in each of the two sectors for settings: ``FLASH_SECTOR_WORDS`` of ``qemu.c``."""
LOG_BLOCK_COUNT = 30720
"""Blocks of 512 bytes for the log: ``LOG_BLOCK_COUNT`` of ``qemu.c``."""
_RECEIVER_KIND_OFFSET_BYTES = 2**19  # of the word that holds the kind of the receiver
_LOG_OFFSET_BYTES = 2**20  # in the memory that holds the sectors
_FLASH_MEMORY_BYTES = 16 * 2**20  # of the emulated memory that holds sectors and log


class Board(Protocol):
    """Interface of a board, which computes a period in two halves; ``record`` (``board_t *``) is its memory."""

    ffi: Any
    lib: Any
    record: Any
    memory: NDArray[np.uint8]
    log_blocks: NDArray[np.uint32]

    def restart(self) -> None:
        """Return to the state after power-up."""

    def compute_estimate(self, period: Any) -> None:
        """Run the first half of a period, which updates the estimate; ``period`` is a ``board_period_t *``."""

    def compute_control(self, request: Any) -> None:
        """Run the second half of a period, which computes the actuator inputs (``board_request_t * request``)."""

    def close(self) -> None:
        """End the run of the board and release its resources."""


class HostBoard:
    """Board whose C code runs as a library on this machine, with models of its flash and block device.

    Parameters
    ----------
    ffi, lib
        From :func:`mufly.firmware.emulated.image_build.build_host_board`.

    Attributes
    ----------
    flash : (2 * FLASH_SECTOR_WORDS,) array of uint32
        Contents of both sectors for settings; blank at first, kept over restarts.
    log_blocks : (LOG_BLOCK_COUNT, 128) array of uint32
        Contents of the block device of the log, kept over restarts.
    flash_model, block_model : cffi pointers
        Models of flash and block device, with their faults.
    """

    def __init__(self, ffi: Any, lib: Any) -> None:
        self.ffi, self.lib = ffi, lib
        self.flash = np.full(2 * FLASH_SECTOR_WORDS, 0xFFFFFFFF, np.uint32)
        self._weak_bits = np.zeros_like(self.flash)
        self.flash_model = ffi.new("flash_model_t *")
        model = self.flash_model
        model.words, model.weak = (ffi.cast("uint32_t *", ffi.from_buffer(a)) for a in (self.flash, self._weak_bits))
        model.sector_words, model.noise = FLASH_SECTOR_WORDS, 1
        model.cut_after = model.worn_word = model.worn_sector = -1
        self.log_blocks = np.zeros((LOG_BLOCK_COUNT, 128), np.uint32)
        self.block_model = ffi.new("block_model_t *", {"blocks": LOG_BLOCK_COUNT, "noise": 1, "cut_after": -1})
        self.block_model.words = ffi.cast("uint32_t *", ffi.from_buffer(self.log_blocks))
        self.memory = np.zeros(ffi.sizeof("board_t"), np.uint8)
        self.record = ffi.cast("board_t *", ffi.from_buffer(self.memory))
        fitted = lib.mufly_settings.is_fitted
        self._fitted = sum(1 << k for k in range(len(fitted)) if fitted[k])
        self.restart()

    def restart(self) -> None:
        """Return to the state after power-up."""
        self.memory[:] = 0
        self._attach_storage_models()
        self.lib.flash_model_start(self.flash_model)
        self.lib.block_model_start(self.block_model)
        self.lib.board_start(self.record, self._fitted, self.lib.RESTART_COLD)

    def _attach_storage_models(self) -> None:
        self.lib.flash_model_attach(self.flash_model)
        self.lib.block_model_attach(self.block_model)

    def compute_estimate(self, period: Any) -> None:
        """Run the first half of a period, which updates the estimate."""
        self.lib.merge_readings(self.ffi.addressof(self.record, "readings"), self.ffi.addressof(period, "readings"))
        self.lib.board_estimate(self.record, period.time_s, period.missed)

    def compute_control(self, request: Any) -> None:
        """Run the second half of a period, which computes the actuator inputs."""
        given = self.ffi.addressof(request, "given") if request.is_given else self.ffi.NULL
        self._attach_storage_models()
        self.lib.board_control(self.record, given)

    def exchange_bytes(self, received: bytes) -> bytes:
        """Pass received bytes to the board's MAVLink link and return the bytes it sends.

        Call this after the second half of a period.
        """
        link = self.record.link
        link.input_count = min(len(received), len(link.input))
        self.ffi.memmove(link.input, received[: link.input_count], link.input_count)
        self._attach_storage_models()
        self.lib.board_link(self.record)
        out = self.ffi.new("uint8_t[]", len(link.output))
        pointer = self.ffi.addressof(self.record, "link")
        count = self.lib.link_waiting(pointer, out, len(link.output))
        self.lib.link_sent(pointer, count)
        return bytes(self.ffi.buffer(out, count))

    def close(self) -> None:
        """Do nothing: no process runs."""


class EmulatedBoard:
    """The image of a board in QEMU, compared with the same code on this machine after each half of a period.

    Parameters
    ----------
    image : Path
        From :func:`mufly.firmware.emulated.image_build.build_board_image`.
    twin : HostBoard
        The code of this machine, in single precision.
    uart : str
        Device of QEMU for the UART of the link, as ``tcp:127.0.0.1:5760,server=on,wait=off,nodelay=on``.
    receiver, receiver_uart : str
        Kind of a pilot's receiver, ``crsf`` or ``sbus``, and device of QEMU for its UART; "" for a board without one.
    counts_instructions : bool
        Let an instruction take 1 ns, so that the board's timer measures instructions; slower.

    Attributes
    ----------
    period_count, mismatch_count : int
        Compared periods, and those after which any byte of the board's memory differs.
    first_mismatch : str
        Period, field and values of the first difference; "" without one.
    worst_instructions : int
        Of a period, exchange with the simulation excluded, to 40 instructions; 0 unless they are counted.
    flash : (2 * FLASH_SECTOR_WORDS,) array of uint32
        Memory of the emulated board in the place of its flash: both sectors for settings, kept over restarts.
    log_blocks : (LOG_BLOCK_COUNT, 128) array of uint32
        Memory of the emulated board in the place of the log's block device, kept over restarts.
    """

    def __init__(
        self,
        image: Path,
        twin: HostBoard,
        uart: str = "none",
        counts_instructions: bool = False,
        receiver: str = "",
        receiver_uart: str = "none",
    ) -> None:
        self.ffi, self.lib, self._image, self._twin = twin.ffi, twin.lib, image, twin
        self._uart, self._receiver_uart = uart, receiver_uart
        self._receiver = {"": twin.lib.RC_NONE, "crsf": twin.lib.RC_CRSF, "sbus": twin.lib.RC_SBUS}[receiver]
        self._instructions_per_tick = 40 if counts_instructions else 0
        self._ticks = np.zeros(1, np.uint32)
        self.worst_instructions = 0
        self.memory = np.zeros_like(twin.memory)
        self.record = self.ffi.cast("board_t *", self.ffi.from_buffer(self.memory))
        self._layout = MemoryLayout(self.ffi, "board_t")
        self._process: subprocess.Popen[bytes] | None = None
        self.period_count = self.mismatch_count = 0
        self.first_mismatch = ""
        self._flash_file = tempfile.NamedTemporaryFile(prefix="mufly-flash-", suffix=".bin")  # noqa: SIM115
        self._flash_file.truncate(_FLASH_MEMORY_BYTES)
        self.flash = np.memmap(self._flash_file.name, np.uint32, "r+", shape=twin.flash.shape)
        self.flash[:] = twin.flash
        np.memmap(self._flash_file.name, np.int32, "r+", _RECEIVER_KIND_OFFSET_BYTES, 1)[:] = self._receiver
        self.log_blocks: NDArray[np.uint32] = np.memmap(
            self._flash_file.name, np.uint32, "r+", _LOG_OFFSET_BYTES, twin.log_blocks.shape
        )
        self.restart()

    def restart(self) -> None:
        """Reset the board to its state after power-up; QEMU is started again by the next period."""
        self.close()
        self._twin.restart()
        self.lib.rc_start(self.ffi.addressof(self._twin.record, "rc"), self._receiver)
        self.memory[:] = self._twin.memory

    def _start_emulation(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [
                "qemu-system-arm", "-M", f"{EMULATED_MACHINE},memory-backend=flash",
                "-object", f"memory-backend-file,id=flash,size={_FLASH_MEMORY_BYTES},"
                f"mem-path={self._flash_file.name},share=on",
                "-display", "none", "-monitor", "none",
                "-serial", self._uart, "-serial", self._receiver_uart,
                "-semihosting-config", "enable=on,target=native", "-kernel", str(self._image),
                *(("-icount", "shift=0") if self._instructions_per_tick else ()),
            ],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0,
        )  # fmt: skip
        self._process = process
        names = [f"{name}_t" for name in ("board", "board_period", "board_request", "estimator", "software")]
        ours = np.array([self.ffi.sizeof(name) for name in names], np.uint32)
        theirs = np.zeros_like(ours)
        self._read_output_into(process, theirs.view(np.uint8))
        if ours.tolist() != theirs.tolist():
            raise MuflyError(
                f"emulated board: its records have {theirs.tolist()} bytes, here they have {ours.tolist()}"
            )
        return process

    def compute_estimate(self, period: Any) -> None:
        """Run the first half of a period, which updates the estimate."""
        self._run_half_period(period, self._twin.compute_estimate)
        self.period_count += 1

    def compute_control(self, request: Any) -> None:
        """Run the second half of a period, which computes the actuator inputs."""
        self._run_half_period(request, self._twin.compute_control, self._conclude_period)

    def _conclude_period(self) -> None:
        """Record the duration of the period; run the link of the comparison board (twin) with the bytes of the emulated
        UARTs.
        """
        assert self._process is not None
        self._read_output_into(self._process, self._ticks.view(np.uint8))
        spent = int(self._ticks[0]) * self._instructions_per_tick
        self.worst_instructions = max(self.worst_instructions, spent)
        for ours, theirs in ((self.record.link, self._twin.record.link), (self.record.rc, self._twin.record.rc)):
            self.ffi.memmove(theirs.input, ours.input, len(ours.input))
            theirs.input_count = ours.input_count
        self.lib.flash_model_attach(self._twin.flash_model)
        self.lib.board_link(self._twin.record)
        self.lib.link_sent(self.ffi.addressof(self._twin.record, "link"), self.record.link.sent_count)

    def _run_half_period(self, record: Any, compute: Any, conclude: Callable[[], None] = lambda: None) -> None:
        process = self._process or self._start_emulation()
        assert process.stdin is not None
        try:
            process.stdin.write(self.ffi.buffer(record))
        except BrokenPipeError:
            self._raise_emulation_error(process)
        compute(record)  # at the same time
        self._read_output_into(process, self.memory)
        conclude()
        wrong = self._layout.describe_first_difference(self.memory, self._twin.memory)
        if wrong:
            self.mismatch_count += 1
            self.first_mismatch = self.first_mismatch or f"period {self._twin.record.period_count}: {wrong}"

    def _read_output_into(self, process: subprocess.Popen[bytes], into: NDArray[np.uint8]) -> None:
        assert process.stdout is not None
        view, filled = memoryview(into.data), 0
        while filled < len(view):
            count = process.stdout.readinto(view[filled:])  # type: ignore[attr-defined]
            if not count:
                self._raise_emulation_error(process)
            filled += count

    def _raise_emulation_error(self, process: subprocess.Popen[bytes]) -> None:
        process.kill()
        said = (process.communicate()[1] or b"").decode(errors="replace").strip()
        self._process = None
        raise MuflyError(f"emulated board: it ended by itself; QEMU said {said[-200:]!r}")

    def close(self) -> None:
        """End the emulation."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
