"""``mufly bench``: a series on a rotor test bench, from its plan to files that the fits read."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from mufly.cli.options import (
    PITCH,
    SPACING,
    SPEED,
    Commands,
    JsonOption,
    SpacingOption,
    argument,
    one_of,
    option,
)
from mufly.cli.present import answer, check_folder, console, print_table, say
from mufly.errors import InputError
from mufly.grammar import read_values

if TYPE_CHECKING:
    from mufly.bench.rig.devices import Rig
    from mufly.bench.series.analysis import Load, Series, Setting
    from mufly.bench.series.files import Difference
    from mufly.bench.series.plan import Axis, Mounting, Plan, Step
    from mufly.bench.series.record import Record
    from mufly.bench.series.run import Progress

app = Commands(
    help="A rotor test bench: plan a series, run it (simulated, or on devices), analyse and compare; docs/bench.md.",
    no_args_is_help=True,
)

_FAULTS = ("reference", "saturated", "silent", "spikes", "speed")
SeriesArgument = Annotated[Path, argument("DIR", "The folder of `mufly bench run`.")]
AcceptOption = Annotated[
    list[str] | None,
    option(
        "--accept KIND",
        "A doubt that is not to refuse the series: 'reference', 'saturated', ... (again for more).",
    ),
]
KnownOption = Annotated[
    Path | None,
    option(
        "--known FILE",
        "Torque of the reference rotor over speed, for a bench without a torque cell; at the density in the file, "
        "else 1.2 kg/m3.",
    ),
]


_MOST = 1000  # settings of one kind in a plan


@app.command()
def plan(
    rotor: Annotated[list[str], option("--rotor NAME|FILE", "A rotor to measure (again for more).")],
    pitch: Annotated[
        str,
        option("--pitch", "Pitch settings: 10,12,14 or 10:20:2.", unit="deg", form="values", within=PITCH),
    ] = "12",
    rpm: Annotated[
        str, option("--rpm", "Speeds: 3000,5000 or 3000:7000:500.", unit="rpm", form="values", within=SPEED)
    ] = "3000:7000:1000",
    axis: Annotated[str, option("--axis NAME", "'upper', 'lower' or 'pair'.")] = "upper",
    ratio: Annotated[
        str,
        option("--ratio", "Of a pair: speed of the lower rotor over the upper's.", unit="1", form="values"),
    ] = "1",
    repeat: Annotated[
        int, option("--repeat N", "Mountings of each setting; 2 or more show how well they repeat.")
    ] = 2,
    reference: Annotated[
        str | None, option("--reference NAME|FILE", "Reference rotor; default the first --rotor.")
    ] = None,
    reference_pitch: Annotated[
        float, option("--reference-pitch", "Its pitch.", unit="deg", within=PITCH)
    ] = 12.0,
    reference_every: Annotated[
        int, option("--reference-every N", "Mountings between two of the reference.")
    ] = 4,
    warm_up: Annotated[float, option("--warm-up", "Time before the first zero.", unit="s")] = 600.0,
    spacing: SpacingOption = 0.04,
    seed: Annotated[int, option("--seed N", "Draws the order.")] = 0,
    name: Annotated[str, option("--name TEXT", "Of the series.")] = "series",
    out: Annotated[Path, option("--out FILE", "The plan; a file that is there is not replaced.")] = Path(
        "plan.toml"
    ),
    as_json: JsonOption = False,
) -> None:
    """Draw up a series: mountings and speeds in random order, a reference rotor every so often.

    Limits, times and order stand in the file, which may be edited.
    Example: mufly bench plan --rotor naca0012-r60-c20 --pitch 10,14 --reference naca4412-r60-c20
    """
    from mufly.bench.series.plan import AXES, Times, make_plan
    from mufly.cli.present import check_file, writing
    from mufly.rotor import load_rotor

    one_of("--axis", axis, AXES)
    for r in [*rotor, *([reference] if reference else [])]:
        load_rotor(r)
    ratios = list(read_values("--ratio", ratio, "1", most=_MOST))
    made = make_plan(
        name, rotor, read_values("--pitch", pitch, "deg", most=_MOST),
        read_values("--rpm", rpm, "rpm", most=_MOST), reference=reference or rotor[0],
        reference_pitch_deg=reference_pitch, repetitions=repeat, axis=cast("Axis", axis),
        speed_ratios=ratios, reference_every=reference_every, seed=seed,
        times=Times(warm_up_s=warm_up), spacing_m=spacing,
    )  # fmt: skip
    if out.exists():
        raise InputError("--out", str(out), "is there already", "give another name, or take it away")
    check_file("--out", out)
    with writing(out):
        out.write_text(made.text(), encoding="utf-8")

    def show() -> None:
        print_table(
            ("", "use", "blades", "speeds (rpm)"),
            [(f"{k}", m.use, m.in_words(), ", ".join(f"{s:g}" for s in m.speeds_rpm))
             for k, m in enumerate(made.mounting, 1)], text=(1, 2, 3),
        )  # fmt: skip
        say(f"{made.points} points, {len(made.steps)} steps; about {made.seconds() / 60:.0f} min and "
            f"{len(made.mounting)} changes of blades")  # fmt: skip
        if axis == "pair" and len(set(ratios)) < 2:
            say(
                "One ratio of speeds shows the thrust of both rotors together only, --ratio 0.9,1,1.1 that of each."
            )

    answer(
        as_json,
        lambda: {"plan": made.model_dump(), "points": made.points, "seconds": made.seconds()},
        show,
        [out],
    )


@app.command()
def run(
    plan: Annotated[Path, argument("PLAN", "From `mufly bench plan`.")],
    rig: Annotated[str, option("--rig sim|FILE", "'sim', or the file of a bench (docs/bench.md).")] = "sim",
    out: Annotated[Path, option("--out DIR", "The series; one that was stopped goes on there.")] = Path(
        "series"
    ),
    seed: Annotated[int, option("--seed N", "Of a simulated bench.")] = 0,
    fault: Annotated[
        str | None, option("--fault KIND", f"Of a simulated bench: {', '.join(_FAULTS)}.")
    ] = None,
    samples: Annotated[bool, option("--samples", "Keep every sample, not only means.")] = False,
    yes: Annotated[bool, option("--yes", "Do not wait for somebody to change the blades.")] = False,
) -> None:
    """Run a series, or go on with it. Ctrl-C stops the motors, then the program.

    Everything measured is on the disk before the next point begins. live.html in the folder shows the series.
    """
    from mufly.bench.series.live import NAME, write_page
    from mufly.bench.series.plan import read_plan
    from mufly.bench.series.record import Record
    from mufly.bench.series.run import LimitError, Stopped, run_series
    from mufly.cli.station import Ending

    made = read_plan(plan)
    check_folder("--out", out)
    if fault is not None:
        one_of("--fault", fault, _FAULTS)
    real = _real_rig(rig, fault) if rig != "sim" else None
    record = Record(out)
    bench, truth = (real, None) if real is not None else _simulated_rig(made, record, seed, fault)
    page = out / NAME
    err, drawn = console(stderr=True), [0.0]
    say(
        f"{made.name}: {made.points} points on {bench.facts.name}; "
        f"{len(record.done)} of {len(made.steps)} steps are done"
    )
    say(f"Live: {page}")

    with Ending() as ending, err.status("") as status:

        def told(p: Progress) -> None:
            status.update(f"{100 * p.done / p.total:.0f} %  {p.what}")
            if (line := p.line) is not None and line["what"] == "point":
                err.print(_line_of(line, made, p), highlight=False, markup=False)
            # A page a second at most: a simulated bench makes a hundred readings in one.
            if (p.line is not None and time.monotonic() - drawn[0] > 1.0) or p.done == p.total:
                drawn[0] = time.monotonic()
                write_page(out, made, record.lines, p.what, p.done / p.total, over=p.done == p.total)

        def mounted(m: Mounting) -> None:
            if bench.facts.manual and not yes:
                status.stop()
                _wait_for_blades(m, ending.asked)
                status.start()

        try:
            run_series(made, bench, record, asked=ending.asked.is_set, told=told, mounted=mounted, keep_samples=samples,
                       truth=truth)  # fmt: skip
        except (Stopped, LimitError) as error:
            write_page(out, made, record.lines, str(error), len(record.done) / len(made.steps), over=True)
            if isinstance(error, Stopped):
                say(str(error))
                raise typer.Exit(ending.status or 130) from error
            raise
        finally:
            bench.close()
            record.close()
    say(f"Done: {len(record.readings)} readings in {out}; next: mufly bench analyse {out}")


def _line_of(line: dict[str, Any], plan: Plan, p: Progress) -> str:
    m = plan.mounting[line["mounting"]]
    quick = line.get("quick", {})
    loads = ", ".join(
        f"{n} {quick[n] * (1e3 if n == 'torque' else 1):.4g} {'mN m' if n == 'torque' else 'N'}"
        for n in ("thrust", "torque") if n in quick
    )  # fmt: skip
    bad = (
        ""
        if line["settled"] and line["at_speed"] and not line["saturated"]
        else "  NOT USABLE: "
        + (
            "saturated"
            if line["saturated"]
            else "not at its speed"
            if not line["at_speed"]
            else "did not settle"
        )
    )
    blades = f"{m.rotor} {m.pitch_deg:g} deg {m.axis:5s}"
    return f"{p.done:4d}/{p.total}  {blades} {line['speed_rpm']:6.0f} rpm  {loads}{bad}"


def _wait_for_blades(m: Mounting, asked: threading.Event) -> None:
    """Wait for Enter, or for the request to stop."""
    from mufly.bench.series.run import Stopped

    entered = threading.Event()

    def read() -> None:
        sys.stdin.readline()
        entered.set()

    say(f"Mount {m.in_words()}, step back, press Enter.")
    threading.Thread(target=read, daemon=True).start()
    while not entered.wait(0.1):
        if asked.is_set():
            raise Stopped("stopped as asked; the series goes on from here when it is run again")


def _real_rig(name: str, fault: str | None) -> Rig:
    from mufly.bench.rig.file import load_rig

    if fault is not None:
        raise InputError("--fault", fault, "is for a simulated bench", "use it with --rig sim")
    return load_rig(name)


def _simulated_rig(
    plan: Plan, record: Record, seed: int, fault: str | None
) -> tuple[Rig, Callable[[Step], Mapping[str, float]]]:
    from mufly.bench.rig.simulated import Faults, SimulatedRig

    faults = {
        None: Faults(), "reference": Faults(reference_moved_deg=0.5, reference_moved_after=1),
        "saturated": Faults(saturated=True),
        "silent": Faults(silent_after_s=1500.0), "spikes": Faults(spikes=0.05), "speed": Faults(stuck_speed=0.04),
    }[fault]  # fmt: skip
    last = float(record.lines[-1]["time"]) + 60.0 if record.lines else 0.0
    rig = SimulatedRig(seed, faults=faults, spacing_m=plan.spacing_m, time_s=last)

    def truth(step: Step) -> dict[str, float]:
        speeds: dict[str, float] = {a: rig.speed[a] for a in plan.mounting[step.mounting].axes}
        nominal = rig.truth(speeds, as_mounted=False)
        return rig.truth(speeds) | {f"nominal_{k}": v for k, v in nominal.items()}

    return rig, truth


@app.command()
def analyse(
    series: SeriesArgument,
    accept: AcceptOption = None,
    known: KnownOption = None,
    out: Annotated[Path | None, option("--out DIR", "Results; default DIR/results.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what a series found, with 95 % intervals, and whether to believe it; write it as files for the fits.

    A series that cannot be trusted is refused: status 1, the reasons, no results.
    """
    from mufly.bench import read_measurements
    from mufly.bench.series.analysis import analyse as analysed
    from mufly.bench.series.files import write_results

    found = analysed(series, known=None if known is None else read_measurements(known), accept=accept or [])
    folder = out or series / "results"
    files = [] if found.refused else write_results(found, folder)
    # Standard output is the answer; refusals are errors as any other, after it.
    answer(as_json, lambda: {"series": found, "refused": bool(found.refused)}, lambda: _show(found), files)
    single = next((s for s in found.settings if s.axis != "pair"), None)
    if files and single is not None and not as_json:
        say(f"Next: mufly rotor compare {single.rotor} {files[0]}")
    if found.refused:
        kinds = ", ".join(sorted({d.kind for d in found.refused}))
        raise InputError(
            str(series),
            "",
            f"is not to be trusted ({kinds})",
            "measure again, or --accept what you can explain",
        )


def _cell(load: Load | None, scale: float = 1.0) -> str:
    if load is None:
        return "-"
    return f"{scale * load.value:.4g} ± {scale * load.expanded:.2g}"


def _show(found: Series) -> None:
    def row(s: Setting) -> tuple[str, ...]:
        speeds = (
            f"{s.speed_upper_rpm:.0f}, {s.speed_lower_rpm:.0f}"
            if s.axis == "pair"
            else (f"{s.speed_lower_rpm if s.axis == 'lower' else s.speed_upper_rpm:.0f}")
        )
        torque = (
            (_cell(s.torque_upper, 1e3), _cell(s.torque_lower, 1e3))
            if s.axis == "pair"
            else (_cell(s.torque, 1e3), "")
        )
        return (s.rotor, s.axis, f"{s.pitch_deg:g}", speeds, f"{s.mountings}", _cell(s.thrust), *torque)

    pair = any(s.axis == "pair" for s in found.settings)
    heads = ("rotor", "axis", "pitch (deg)", "speed (rpm)", "mounted", "thrust (N)",
             "torque upper (mN m)" if pair else "torque (mN m)", "torque lower (mN m)" if pair else "")  # fmt: skip
    rows = [row(s) for s in found.settings]
    cut = len(heads) if pair else len(heads) - 1
    print_table(heads[:cut], [r[:cut] for r in rows], text=(0, 1, 3), title=f"{found.name}, 95 % intervals")
    say(*found.notes)
    for load, tau in found.repeat.items():
        if math.isfinite(tau):
            say(f"{load}: mountings of the same setting differ by {100 * tau:.2f} % (one standard deviation)")
    if all(s.mountings < 2 for s in found.settings):
        say(
            "no setting was mounted twice: intervals are for the blades as they were mounted, not for their pitch"
        )
    inside = [
        abs(load.value - s.truth[f"nominal_{q}"]) <= load.expanded
        for s in found.settings for q in ("thrust", "torque_upper", "torque_lower")
        if (load := getattr(s, q)) is not None and f"nominal_{q}" in s.truth
    ]  # fmt: skip
    if inside:
        say(f"simulated bench: {sum(inside)} of {len(inside)} intervals hold the truth")
    for d in found.doubts:
        say(d.text, mark="REFUSED" if d.fatal else "note", style="red" if d.fatal else "yellow")


@app.command()
def compare(
    series: SeriesArgument,
    other: Annotated[
        Path | None, argument("DIR", "Another series of the same blades; without it blade element theory.")
    ] = None,
    spacing: Annotated[
        float | None,
        option("--spacing", "Between the discs of a pair; default the plan's.", unit="m", within=SPACING),
    ] = None,
    accept: AcceptOption = None,
    known: KnownOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set a series beside another one, or beside blade element momentum theory.

    E_n is the difference over its 95 % uncertainty: beyond 1 the two disagree.
    """
    import tomllib

    from mufly.bench import read_measurements
    from mufly.bench.series.analysis import analyse as analysed
    from mufly.bench.series.files import compare_series, compare_theory
    from mufly.bench.series.record import read_record

    torque = None if known is None else read_measurements(known)
    first = _trusted(analysed(series, known=torque, accept=accept or []), series)
    found: list[Difference]
    if other is None:
        if spacing is None:
            spacing = float(tomllib.loads(read_record(series).head["plan"])["spacing_m"])
        found = compare_theory(first, spacing_m=spacing)
    else:
        found = compare_series(first, _trusted(analysed(other, known=torque, accept=accept or []), other))

    def show() -> None:
        print_table(
            ("setting", "first" if other else "bench", "second" if other else "theory", "off", "E_n"),
            [(d.what, f"{d.first:.4g}", f"{d.second:.4g}", f"{100 * d.relative:+.1f} %", f"{d.normalised:+.2f}")
             for d in found], text=(0,),
        )  # fmt: skip
        beyond = sum(abs(d.normalised) > 1 for d in found)
        mean = sum(abs(d.relative) for d in found) / len(found)
        say(
            f"{beyond} of {len(found)} differ by more than their uncertainty; "
            f"mean absolute difference {100 * mean:.1f} %"
        )

    answer(as_json, lambda: {"differences": found}, show)


def _trusted(found: Series, where: Path) -> Series:
    if found.refused:
        raise InputError(
            str(where), "", found.refused[0].text, "look at `mufly bench analyse`, or --accept the kind"
        )
    return found
