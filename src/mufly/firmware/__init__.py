"""Export the flight software as C99 with a vehicle's numbers, and build, fly and verify it on this machine."""

from mufly.compiled.toolchain import find_compiler
from mufly.firmware.compiled_software import FirmwareSoftware, GenericFirmwareSoftware
from mufly.firmware.export.policy_export import export_policy
from mufly.firmware.export.source_export import export_firmware, render_gains_source
from mufly.firmware.fixed_point.fixed_point_design import (
    FixedPointLaw,
    OverflowProof,
    QuantisationLoss,
    measure_cascade_margin_loss,
    quantise_law,
)
from mufly.firmware.fixed_point.fixed_point_flights import (
    FixedPointFlightComparison,
    FixedPointFlights,
    compare_fixed_point_flights,
)
from mufly.firmware.fixed_point.fixed_point_law import (
    FixedPointFirmwareControllers,
    export_fixed_point,
)
from mufly.firmware.host_build import Firmware, FirmwareControllers, build_library
from mufly.firmware.proof.evidence_report import measure_and_write_report
from mufly.firmware.proof.fuzzing import FuzzResult, describe_missing_fuzzer_tools, fuzz_firmware, run_fuzzer
from mufly.firmware.proof.sil_pil import (
    PilComparison,
    PilResult,
    SilComparison,
    SilResult,
    describe_missing_tools,
    find_deepest_stack,
    run_pil,
    run_sil,
)

__all__ = [
    "Firmware",
    "FirmwareControllers",
    "FirmwareSoftware",
    "FixedPointFirmwareControllers",
    "FixedPointFlightComparison",
    "FixedPointFlights",
    "FixedPointLaw",
    "FuzzResult",
    "GenericFirmwareSoftware",
    "OverflowProof",
    "PilComparison",
    "PilResult",
    "QuantisationLoss",
    "SilComparison",
    "SilResult",
    "build_library",
    "compare_fixed_point_flights",
    "describe_missing_fuzzer_tools",
    "describe_missing_tools",
    "export_firmware",
    "export_fixed_point",
    "export_policy",
    "find_compiler",
    "find_deepest_stack",
    "fuzz_firmware",
    "measure_and_write_report",
    "measure_cascade_margin_loss",
    "quantise_law",
    "render_gains_source",
    "run_fuzzer",
    "run_pil",
    "run_sil",
]
