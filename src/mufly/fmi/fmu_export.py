"""Export of a vehicle as an FMI 3.0 co-simulation unit (FMU).

The archive holds ``modelDescription.xml``, ``sources/`` with ``buildDescription.xml``, a library for this machine in
``binaries/`` if there is a C compiler, ``documentation/`` with the licence, and the vehicle file in ``resources/``.
Equal vehicles give equal archives.
"""

from __future__ import annotations

import platform
import tempfile
import zipfile
from pathlib import Path

from mufly.compiled.toolchain import COMPILER_FLAGS, compile_library, find_compiler
from mufly.errors import MuflyError, convert_write_errors
from mufly.files.answer_store import replace_file_atomically
from mufly.fmi.model_description import (
    model_identifier,
    render_build_description,
    render_documentation_page,
    render_model_description,
)
from mufly.fmi.unit_sensors import UnitSensors
from mufly.fmi.unit_sources import (
    SOURCE_FOLDER,
    UNIT_SOURCE,
    render_flight_model,
    render_sensor_sources,
    render_vehicle_data,
)
from mufly.fmi.unit_variables import list_fmu_variables
from mufly.results import ShownBlock, result, tabulate_fields
from mufly.vehicle import Vehicle, format_vehicle_toml

_COPIED_SOURCES = (UNIT_SOURCE, "unsupported_functions.h", "fmi3.h")
_FMI_MACHINE_NAMES = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
_FMI_SYSTEM_NAMES_AND_ENDINGS = {
    "linux": ("linux", ".so"),
    "darwin": ("darwin", ".dylib"),
    "windows": ("windows", ".dll"),
}
_ZIP_ENTRY_TIME = (1980, 1, 1, 0, 0, 0)


@result(
    json="file model=model_identifier token platform input_count output_count start_value_count parameter_count "
    "seed_count fixed_keys"
)
class ExportedUnit:
    """Exported co-simulation unit.

    Attributes
    ----------
    file : str
        Archive.
    model_identifier : str
        Model identifier.
    token : str
        Instantiation token: a hash of the sources.
    platform : str
        Platform of the library in the archive; "" without one.
    input_count, output_count, start_value_count, parameter_count : int
        Numbers of variables.
    seed_count : int
        Number of seeds of the sensors; 0 without sensors.
    fixed_keys : tuple of str
        Keys of the vehicle file that the unit cannot change.
    """

    file: str
    model_identifier: str
    token: str
    platform: str
    input_count: int
    output_count: int
    start_value_count: int
    parameter_count: int
    seed_count: int
    fixed_keys: tuple[str, ...]

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the contents of the unit as printed text."""
        counts = ("input_count", "output_count", "parameter_count", "start_value_count", "seed_count")
        platform = self.platform or "none: C sources only"
        columns = (*counts, ("library", platform), ("fixed keys", ", ".join(self.fixed_keys)))
        return [tabulate_fields(self, columns, title=f"Unit {self.model_identifier}")]


def platform_tuple() -> tuple[str, str]:
    """Return FMI's name of this platform and the suffix of its libraries; ("", "") for a platform unknown to FMI."""
    machine, system = (
        _FMI_MACHINE_NAMES.get(platform.machine().lower()),
        _FMI_SYSTEM_NAMES_AND_ENDINGS.get(platform.system().lower()),
    )
    return ("", "") if machine is None or system is None else (f"{machine}-{system[0]}", system[1])


def export_fmu(vehicle: Vehicle, out: Path, *, binary: bool = True, seeds: int = 0) -> ExportedUnit:
    """Write a vehicle as an FMI 3.0 co-simulation unit.

    Parameters
    ----------
    vehicle : Vehicle
    out : Path
        File to write, ``.fmu``.
    binary : bool
        Compile a library for this machine, if it has a C compiler.
    seeds : int
        Number of seeds of the vehicle's sensors and filter; with 0 the unit has neither.

    Returns
    -------
    ExportedUnit

    Raises
    ------
    InputError
        If the vehicle is too heavy to hover, has no sensors although the unit has, or the file cannot be written.
    MuflyError
        If the vehicle has no trim in hover, or compilation fails.
    """
    sensors = UnitSensors(vehicle, seeds) if seeds else None
    interface, name = list_fmu_variables(vehicle, sensors), model_identifier(vehicle)
    data, token = render_vehicle_data(vehicle, interface, sensors)
    sources = {file: (SOURCE_FOLDER / file).read_text(encoding="utf-8") for file in _COPIED_SOURCES}
    sources |= {"flight_model.h": render_flight_model(sensors), "vehicle_data.h": data}
    sources |= {} if sensors is None else render_sensor_sources(sensors)
    files: dict[str, str | bytes] = {f"sources/{file}": text for file, text in sources.items()}
    files |= {
        "modelDescription.xml": render_model_description(vehicle, interface, token),
        "sources/buildDescription.xml": render_build_description(vehicle, sensors is not None),
        "documentation/index.html": render_documentation_page(vehicle, interface),
        "documentation/licenses/license.txt": (SOURCE_FOLDER / "license.txt").read_text(encoding="utf-8"),
        "resources/vehicle.toml": format_vehicle_toml(vehicle),
    }
    place, ending = platform_tuple()
    if binary and place and _has_compiler():
        files[f"binaries/{place}/{name}{ending}"] = _compile_unit(sources, name + ending)
    else:
        place = ""
    with (
        convert_write_errors(out),
        replace_file_atomically(out) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for file, content in sorted(files.items()):
            info = zipfile.ZipInfo(file, _ZIP_ENTRY_TIME)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, content)
    return ExportedUnit(
        file=str(out), model_identifier=name, token=token, platform=place,
        input_count=interface.count_variables("input"), output_count=interface.count_variables("output"),
        start_value_count=interface.count_variables("start", "step"),
        parameter_count=interface.count_variables("parameter"), seed_count=seeds,
        fixed_keys=tuple(interface.fixed_keys),
    )  # fmt: skip


def _has_compiler() -> bool:
    try:
        find_compiler()
    except MuflyError:
        return False
    return True


def _compile_unit(sources: dict[str, str], library: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="mufly-fmu-") as temporary:
        folder = Path(temporary)
        for file, text in sources.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
        compile_library(sorted(folder.rglob("*.c")), folder / library, flags=(*COMPILER_FLAGS, f"-I{folder}"))
        return (folder / library).read_bytes()
