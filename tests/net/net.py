"""The net: what mufly answers today, frozen, so that a change of structure that changes an answer is seen.

``python tests/net/net.py freeze [--only WORD]`` writes the expectations, ``check [--only WORD]`` compares with them bit
for bit, ``list`` names the cases. Everything goes through the command line and the names that rooms export, so inner
modules may move freely; public names that are renamed are followed in ``API``. ``--only`` takes a part of a case's
name, several with commas.

A number is frozen with nine digits and, where it stands in an array, with a hash of the array's bytes: a difference in
the last bits alone is told as such ("last bits"), and is a difference all the same. ``tests/net/test_net.py`` runs the
quick cases, to five digits, so that it holds on other processors too (a polar's last digits are theirs: 1e-6 of c_l).

When an answer changes on purpose: ``freeze --only CASE``, with the reason in the commit.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import importlib
import io
import json
import math
import os
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

# Sums over threads depend on how many there are.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "2" if _name.startswith("NUMBA") else "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np  # noqa: E402

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parents[1] / "docs" / "examples"

# Public names, in case one of them is renamed: what the cases call it -> where it is.
API = {
    name: f"mufly.{place}"
    for name, place in {
        "load_vehicle": "vehicle:load_vehicle",
        "load_coefficient_map": "vehicle:load_coefficient_map",
        "load_mission": "mission:load_mission",
        "fly": "flight:fly_mission",
        "summarise": "flight:summarise_flight",
        "events_of": "flight:read_events",
        "fit_motor": "identify:fit_motor",
        "fit_rotor": "identify:fit_rotor_coefficients",
        "run_demo": "identify:run_identification_demo",
        "identify_linear": "identify:identify_linear_model",
        "read_columns": "identify:read_columns",
        "choose_free": "identify:choose_free_parameters",
        "plan": "identify:design_excitation",
        "excitation": "identify:make_excitation",
        "read_bench": "bench:read_bench_file",
        "corrected_loads": "bench:compute_loads",
        "load_rotor": "rotor:load_rotor",
        "replace_rotor": "rotor:replace_rotor",
        "prepare": "rotor:prepare_blading",
        "polar": "rotor:compute_polar",
        "hover": "rotor:solve_rotor",
        "hover_batch": "rotor:solve_rotor_batch",
        "solve_thrust": "rotor:solve_for_thrust",
        "solve": "rotor:solve_system",
        "System": "rotor:RotorSystem",
        "Condition": "rotor:OperatingCondition",
        "interval": "rotor:predict_interval",
        "WakeSettings": "rotor.wake:WakeSettings",
        "Setup": "study:StudySetup",
        "evaluate": "study:evaluate_cases",
        "design": "control:design_flight_controller",
        "trim_state": "dynamics:find_trim",
        "linearise": "dynamics:linearise_vehicle",
        "hover_performance": "dynamics:hover_performance",
        "simulate": "dynamics:simulate_open_loop",
        "model_parameters": "dynamics:model_parameters",
        "read_log": "logs:read_log",
        "load_drive": "drive:load_drive",
        "parse_endpoint": "link:parse_endpoint",
        "parse_global_origin": "link:parse_global_origin",
        "run_study": "thesis:run_study",
        "to_plain_data": "results:to_plain_data",
    }.items()
}

CHANGING = {
    "seconds",
    "realtime_factor",
    "start_time",
    "start_time_ns",
}  # keys whose values no two runs share
DIGITS = 9
LONG = 8  # arrays longer than this are kept as a hash and a few numbers


def api(name: str) -> Any:
    """A public function or class by its name in ``API``."""
    module, _, attribute = API[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


# --- how an answer is written down ------------------------------------------------------------------------------------


def rounded(x: float) -> float | str:
    if not math.isfinite(x):
        return str(x)
    return float(f"{x:.{DIGITS}g}")


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]


def array(values: np.ndarray) -> str:
    """One line for an array: type, shape, hash of its bytes, and a few of its numbers."""
    a = np.ascontiguousarray(values)
    if a.dtype.kind not in "fiub":
        text = [str(x) for x in a.ravel()]
        return f"text {list(a.shape)} #{digest(chr(0).join(text).encode())} {' | '.join(text[:3])[:80]}"
    flat = a.ravel().astype(float)
    good = flat[np.isfinite(flat)]
    told = [flat[0], flat[flat.size // 2], flat[-1], good.mean(), good.std()] if good.size else []
    numbers = " ".join(f"{x:.{DIGITS}g}" for x in told)
    return f"{a.dtype} {list(a.shape)} #{digest(a.tobytes())} {numbers}"


def _numbers(x: Any) -> bool:
    """Whether this is a list of numbers (null and lists of such among them)."""
    return isinstance(x, list) and len(x) > 0 and all(
        y is None or (isinstance(y, int | float) and not isinstance(y, bool)) or _numbers(y) for y in x
    )  # fmt: skip


def _floats(x: Any) -> Any:
    return math.nan if x is None else [_floats(y) for y in x] if isinstance(x, list) else float(x)


def _size(x: Any) -> int:
    return sum(map(_size, x)) if isinstance(x, list) else 1


def written(value: Any) -> Any:
    """What is kept of an answer: floats to nine digits beside a hash, long arrays as a line."""
    if isinstance(value, dict):
        kept = {str(k): written(v) for k, v in value.items() if k not in CHANGING}
        floats = [v for k, v in value.items() if k not in CHANGING and isinstance(v, float)]
        if floats:
            kept["#"] = digest(np.array(floats).tobytes())
        return kept
    if isinstance(value, np.ndarray):
        return array(value)
    if isinstance(value, np.generic):
        return written(value.item())
    if isinstance(value, tuple):
        return written(list(value))
    if isinstance(value, list):
        if _numbers(value) and _size(value) > LONG:
            try:
                return array(np.array(_floats(value)))
            except ValueError:
                pass
        return [written(v) for v in value]
    if isinstance(value, float):
        return rounded(value)
    if value is None or isinstance(value, str | int | bool):
        return value
    return str(value)


def fields(thing: Any) -> dict[str, Any]:
    """The numbers and texts of a result, whatever class it is of."""
    out: dict[str, Any] = {}
    for name in getattr(thing, "__dataclass_fields__", None) or vars(thing):
        value = getattr(thing, name)
        if isinstance(value, np.ndarray | np.generic | float | int | str | bool) or value is None:
            out[name] = value
        elif isinstance(value, tuple | list) and all(isinstance(v, float | int | str | np.generic) for v in value):
            out[name] = list(value)
        elif hasattr(value, "nstates"):
            out[name] = {k: np.asarray(getattr(value, k), dtype=float) for k in "ABCD"}
    return out


def dataset(data: Any) -> dict[str, Any]:
    """Every variable of a labelled table, as a line."""
    out = {str(n): array(data[n].values) for n in [*data.coords, *data.data_vars]}
    out["attrs"] = {
        str(k): v
        for k, v in data.attrs.items()
        if isinstance(v, str | int | float | list) and k not in CHANGING and len(str(v)) < 400
    }
    return out


# --- the command line, in this process --------------------------------------------------------------------------------


def run(*words: str) -> tuple[int, str, str]:
    """Run ``mufly words``; status, standard output, standard error."""
    import typer.main

    from mufly import cli

    if not hasattr(typer.main.get_command, "cache_info"):  # the tree of commands is built once, not for each call
        typer.main.get_command = functools.cache(typer.main.get_command)
    out, err = io.StringIO(), io.StringIO()
    before = sys.argv
    sys.argv = ["mufly", *words]
    status = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cli.main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    finally:
        sys.argv = before
    return status, out.getvalue(), err.getvalue()


def answer(*words: str) -> Any:
    """What a command with --json prints."""
    status, out, err = run(*words, "--json")
    try:
        return {"status": status, "json": json.loads(out)}
    except ValueError:
        return {"status": status, "out": out, "err": err.splitlines()}


def text_of(raw: str) -> list[str]:
    """Lines without frames, runs of blanks, and what differs between two places."""
    here = str(Path.cwd())
    lines = []
    for line in raw.replace(here, "HERE").splitlines():
        plain = re.sub(r"[\u2500-\u257f]", " ", re.sub(r"\x1b\[[0-9;]*m", "", line))
        plain = " ".join(plain.split())
        if plain:
            lines.append(plain)
    return lines


# --- files that cases read --------------------------------------------------------------------------------------------


def sticks(n: int = 1500, dt: float = 0.04) -> None:
    """A made flight of a first-order linear helicopter, as CSV."""
    rng = np.random.default_rng(3)
    u = 0.1 * np.column_stack([np.repeat(rng.normal(size=n // 20 + 1), 20)[:n] for _ in range(2)])
    a, b = np.array([[-6.0, 1.5], [-3.0, -5.0]]), np.array([[18.0, -5.0], [3.0, 12.0]])
    y = np.zeros((n, 2))
    for k in range(1, n):
        y[k] = y[k - 1] + dt / 4 * sum((a @ y[k - 1] + b @ u[k - 1]) * (1 + 0.0 * j) for j in range(4))
    y += 0.01 * rng.normal(size=y.shape)
    rows = np.column_stack([dt * np.arange(n), u, y])
    np.savetxt("sticks.csv", rows, delimiter=",", header="time_s,lat,lon,p,q", comments="", fmt="%.9g")


def waves() -> None:
    """A made log with a gap, an outlier, a frozen and a delayed channel."""
    t = np.arange(0.0, 12.0, 0.01)
    t = np.concatenate([t[:400], t[460:]])
    rng = np.random.default_rng(5)
    roll = 0.2 * np.sin(2.0 * t)
    seen = 0.2 * np.sin(2.0 * (t - 0.05)) + 0.001 * rng.normal(size=t.size)
    seen[777] = 40.0
    frozen = np.where(t > 6, 0.3, rng.normal(size=t.size))
    head = "t(s),roll,roll_ref,gyro_x(deg/s),U(V)"
    rows = np.column_stack([t, seen, roll, np.degrees(0.4 * np.cos(2 * t)), 12.0 + 0.01 * frozen])
    np.savetxt("waves.csv", rows, delimiter=",", header=head, comments="", fmt="%.9g")


FILES = {
    "hop.toml": '[take_off]\nheight_m = 0.5\nwait_s = 0.2\n\n[[waypoint]]\nposition_m = [0.3, 0.0, -0.5]\n'
    "wait_s = 0.2\n",
    "wall.toml": "[[waypoint]]\nposition_m = [0.3, 0.0, -90.5]\n",
    "typo.toml": "[take_off]\nheight = 0.5\n\n[[waypoint]]\nposition_m = [0.3, 0.0, -0.5]\n",
    "broken.toml": "[[waypoint\n",
    "bench.csv": "pitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.151,0.0015\n12,6000,0.22,0.0022\n",
    "bad_bench.csv": "pitch_deg,speed_rpm,thrust_N\n12,5000,oops\n",
    "bad_rotor.toml": 'name = "bad"\nblades = 2\nradius = -0.06\n',
    "bad_vehicle.toml": 'name = "bad"\n',
    "bad_drive.toml": "motor = 3\n",
}  # fmt: skip


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """An empty folder with the files that cases read, as the current one; a terminal of fixed width."""
    before, env = (
        Path.cwd(),
        {k: os.environ.get(k) for k in ("COLUMNS", "TERMINAL_WIDTH", "NO_COLOR", "TERM")},
    )
    folder = Path(tempfile.mkdtemp(prefix="net"))
    os.environ.update(COLUMNS="110", TERMINAL_WIDTH="110", NO_COLOR="1", TERM="dumb")
    os.environ.pop("FORCE_COLOR", None)
    try:
        os.chdir(folder)
        for name, text in FILES.items():
            Path(name).write_text(text, encoding="utf-8")
        for file in EXAMPLES.glob("*.csv"):
            shutil.copy(file, folder)
        sticks()
        waves()
        yield folder
    finally:
        os.chdir(before)
        for key, value in env.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
        shutil.rmtree(folder, ignore_errors=True)


# --- the cases --------------------------------------------------------------------------------------------------------

CASES: dict[str, Callable[[], Any]] = {}
QUICK: set[str] = set()


def case(name: str, *, quick: bool = False) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    def add(function: Callable[[], Any]) -> Callable[[], Any]:
        CASES[name] = function
        if quick:
            QUICK.add(name)
        return function

    return add


def command(name: str, words: str, *, quick: bool = False) -> None:
    """A command whose --json is frozen."""
    case(f"json.{name}", quick=quick)(lambda: answer(*words.split()))


COARSE = "--wake-set chord_deg=15 --wake-set turns=2 --wake-set far_turns=6 --wake-set stations=10 " \
    "--wake-set tolerance=0.01"  # fmt: skip
POINT = "--pitch 12 --rpm 5000"

for _name, _words, _quick in (
    ("vehicle.list", "vehicle list", True),
    ("vehicle.show-1.1", "vehicle show mufly-1.1", True),
    ("vehicle.show-2.0", "vehicle show mufly-2.0", True),
    ("vehicle.check-1.1", "vehicle check mufly-1.1", True),
    ("vehicle.check-2.0", "vehicle check mufly-2.0", True),
    ("mission.list", "mission list", True),
    ("mission.show-demonstration", "mission show demonstration", True),
    ("mission.show-box", "mission show box-on-leg", True),
    ("mission.check-demonstration", "mission check demonstration", True),
    ("mission.check-box", "mission check box-on-leg --vehicle mufly-2.0", True),
    ("control.design-1.1", "control design", False),
    ("control.design-2.0", "control design mufly-2.0 --rate 250 --voltage 8", False),
    ("drive.show", "drive show --thrust 0.3 --thrust 0.45 --charge 0.5", True),
    ("drive.show-rotor", "drive show --rotor naca4412-r60-c20 --pitch 12 --thrust 0.3", False),
    ("drive.sweep", "drive sweep --gear 0.5:8:0.5 --thrust 0.6", False),
    ("rotor.list", "rotor list", True),
    ("rotor.show", "rotor show walkera-5g6 --rpm 4000", True),
    ("rotor.parameters", "rotor parameters", True),
    ("rotor.hover", f"rotor hover naca4412-r60-c20 {POINT} --drive mufly", True),
    ("rotor.hover-thrust", "rotor hover naca0012-r60-c20 --pitch 12 --thrust 0.2 --model thesis", False),
    ("rotor.hover-climb", "rotor hover walkera-5g6 --rpm 4000 --thrust 0.4 --climb 1 --n-crit 9", False),
    ("rotor.hover-band", f"rotor hover naca4412-r60-c20 {POINT} --band 0.9", False),
    ("rotor.hover-wake", f"rotor hover naca0012-r60-c20 {POINT} --method wake {COARSE}", False),
    ("rotor.hover-wake-thrust", f"rotor hover naca0012-r60-c20 --pitch 12 --thrust 0.2 --method wake {COARSE} "
     "--out wake", False),
    ("rotor.hover-prescribed", f"rotor hover naca0012-r60-c20 {POINT} --method wake --wake prescribed {COARSE}", False),
    ("rotor.compare", "rotor compare naca0012-r60-c20 bench.csv", False),
    ("rotor.compare-calibrated", "rotor compare naca0012-r60-c20 bench.csv --calibrate 1", False),
    ("rotor.compare-wake", f"rotor compare naca0012-r60-c20 bench.csv --method wake {COARSE}", False),
    ("rotor.sweep", "rotor sweep --vary chord=15:20:5mm --vary pitch=10:14:2deg --set thrust=0.4N --set gear=adapted "
     "--drive mufly --out chords", False),
    ("rotor.sweep-wake", f"rotor sweep naca0012-r60-c20 --vary pitch=10,14deg --set speed=5000rpm --method wake "
     f"{COARSE}", False),
    ("rotor.rank", "rotor rank --airfoils naca0012,naca4406 --pitch 10:18:4deg", False),
    ("rotor.optimise", "rotor optimise --free taper,gear --generations 3 --limit thickness_mm>=0.8", False),
    ("coax.hover-bemt", "coax hover naca0012-r60-c20 naca4412-r60-c20 --method bemt --pitch 14,12 --spacing 3cm",
     False),
    ("coax.hover-climb", "coax hover --method bemt --climb 1 --no-isolated", False),
    ("coax.hover-wake", f"coax hover {COARSE} --out pair", False),
    ("coax.trim-speed", "coax trim --rpm 6000 --method bemt", False),
    ("coax.trim-thrust", "coax trim --thrust 0.9 --method bemt", False),
    ("coax.trim-pitch", "coax trim --rpm 6000,6300 --free lower-pitch --method bemt --isolated", False),
    ("coax.trim-wake", f"coax trim --rpm 6000 {COARSE}", False),
    ("coax.trim-wake-pitch", f"coax trim --rpm 6000,6300 --free lower-pitch {COARSE}", False),
    ("coax.sweep", "coax sweep --method bemt --vary spacing=4,20mm --vary lower_rpm=5500:6500:500 --set "
     "upper_rpm=6000 --over lower_speed --plot lower_thrust_N --out sweep", False),
    ("coax.sweep-thrust", "coax sweep --method bemt --vary thrust=0.5,0.8N", False),
    ("coax.sweep-wake", f"coax sweep --vary spacing=15,25mm --set upper_rpm=6000 --set speed_ratio=1 {COARSE}", False),
    ("coax.optimise", "coax optimise --thrust 0.4 --vary upper_pitch,lower_pitch --generations 2 --no-check --wake-set "
     "stations=10", False),
    ("coax.parameters", "coax parameters", True),
    ("coax.map", "coax map walkera-5g6 --rpm 4000 --ratio 0.8:1.4:0.2 --climb -1:2:1m/s", False),
    ("identify.motor", "identify motor motor_bench.csv --vehicle mufly-1.1", True),
    ("identify.motor-gear", "identify motor motor_bench.csv --gear 1.5+-0.01 --gear-efficiency free "
     "--noise current=1%+0.01,speed=0.5%fs", False),
    ("identify.rotor", "identify rotor rotor_bench.csv --radius 0.0875+-0.0002 --calibration load_cells.csv", False),
    ("identify.rotor-compared", "identify rotor bench.csv --radius 0.06 --density 1.2 --rotor naca0012-r60-c20", False),
    ("identify.plan", "identify plan mufly-1.1 --free cT_dw,cQ_dw,Jdrive_dw --channel yaw,heave --duration 5", False),
    ("identify.plan-roll", "identify plan mufly-1.1 --free l_up,Tf_up --channel roll --kind 3211 --duration 4 --band "
     "0.3:3 --limit attitude_deg=10 --noise roll=0.02,speed_up=2 --amplitude 0.1", False),
    ("identify.linear", "identify linear sticks.csv --inputs lat,lon --outputs p,q --model first-order-coupled "
     "--starts 2", False),
    ("identify.linear-auto", "identify linear sticks.csv --inputs lat,lon --outputs p,q --starts 1 --rate 12.5", False),
    ("log.info", "log info waves.csv -c time=t(s) -c measured_attitude.roll=roll -c "
     "reference_attitude.roll=roll_ref -c measured_rates.p=gyro_x(deg/s) -c battery_voltage=U(V)", True),
    ("fly.demonstration", "fly demonstration --sensors ideal --out flown --seed 3", False),
    ("fly.box", "fly box-on-leg --vehicle mufly-2.0 --sensors ideal --out flown --wind 0.3,0,0 --gust 0.2 --seed 7",
     False),
):  # fmt: skip
    command(_name, _words, quick=_quick)


@case("json.identify.demo-and-flight")
def _demo() -> Any:
    out = {"demo": answer("identify", "demo", "--seed", "3", "--logs", "flights")}
    options = ["--part", "roll-pitch", "--delay", "25", "--free", "l_up,Tf_up", "--out", "found.toml"]
    flights = ["flights/demo-roll.mcap", "--hold-out", "flights/demo-mixed.mcap"]
    out["flight"] = answer("identify", "flight", *flights, *options)
    vehicle = Path("found.toml").read_text(encoding="utf-8")
    out["vehicle"] = [x for x in vehicle.splitlines() if "identified" in x and "linkage" not in x][:4]
    out["vehicle"] = [re.sub(r"\d{4}-\d\d-\d\d", "DATE", x) for x in out["vehicle"]]
    split = ["--part", "split", "--free", "cQ_up,Izz,l_up", "--delay", "25", "--no-prior"]
    both = ["flights/demo-roll.mcap", "flights/demo-yaw.mcap"]
    out["split"] = answer("identify", "flight", *both, *split)
    out["log"] = answer("log", "info", "flights/demo-roll.mcap")
    return out


def thesis(*words: str) -> Any:
    """What a command of the thesis prints, without what depends on the machine and on what has run on it."""
    found = answer("thesis", *words)
    rows = found["json"] if isinstance(found["json"], list) else [found["json"]]
    for row in rows:
        for key in (
            "picture",
            "seconds",
            *(("word", "agree", "verdicts", "note") if words[0] == "list" else ()),
        ):
            row.pop(key)
    return found


case("json.thesis.list", quick=True)(lambda: thesis("list"))
case("json.thesis.run-fig-3.7")(lambda: thesis("run", "fig-3.7"))  # the other studies take long

HELPS = """
|fly|link|station|rotor|rotor list|rotor show|rotor hover|rotor compare|rotor sweep|rotor parameters|rotor rank
|rotor optimise|coax|coax hover|coax trim|coax sweep|coax parameters|coax optimise|coax map|drive|drive show
|drive sweep|vehicle|vehicle list|vehicle show|vehicle check|control|control design|mission|mission list|mission show
|mission check|identify|identify flight|identify demo|identify motor|identify rotor|identify plan|identify linear|log
|log info|log plot|log convert|log export|thesis|thesis list|thesis run|thesis show|thesis report
""".replace("\n", "").split("|")[1:]  # fmt: skip


@case("help", quick=True)
def _help() -> Any:
    found = {}
    for words in HELPS:
        status, out, err = run(*words.split(), "--help")
        lines = text_of(out + err)
        found[f"mufly {words}".strip()] = {
            "status": status,
            "#": digest(" ".join(lines).encode()),
            "lines": lines,
        }
    return found


@case("text", quick=True)
def _text() -> Any:
    """What a few commands print for people."""
    found = {}
    for words in (
        "--version", "vehicle list", "vehicle check mufly-1.1", "mission list", "mission show box-on-leg",
        "mission check box-on-leg", "rotor list", "thesis show fig-2.2", "drive show --thrust 0.3",
        "vehicle show mufly-2.0 --toml", "mission show box-on-leg --toml", "identify motor motor_bench.csv",
    ):  # fmt: skip
        status, out, err = run(*words.split())
        found[words] = {"status": status, "lines": text_of(out + err)}
    return found


# --- through the library ----------------------------------------------------------------------------------------------


def flown(mission: str, vehicle: str, **options: Any) -> Any:
    m = api("load_mission")(mission)
    data = api("fly")(vehicle, mission, **options)
    events = api("events_of")(data)
    summary = api("summarise")(
        data, [w.position_m for w in m.waypoint], events, take_off=(*m.start_m, -m.take_off.height_m),
        reach_m=m.limits.reach_m, world=m.world,
    )  # fmt: skip
    return {
        "data": dataset(data),
        "events": [f"{e.time_s:.4f} {e.state} {e.level}: {e.text}" for e in events],
        "summary": summary.as_record(),
    }


case("flight.demonstration")(lambda: flown("demonstration", "mufly-1.1", wind=[0.4, 0.2, 0.0], gust=0.3, seed=7))
case("flight.box")(lambda: flown("box-on-leg", "mufly-1.1", wind=[0.2, -0.3, 0.0], gust=0.25, seed=11))


@case("fit.motor", quick=True)
def _motor() -> Any:
    fit = api("fit_motor")(api("read_bench")("motor_bench.csv"), vehicle=api("load_vehicle")("mufly-1.1"))
    return {"estimates": [fields(e) for e in fit.estimates], "covariance": np.asarray(fit.covariance),
            "residual": np.asarray(fit.residual), "undetermined": list(fit.undetermined),
            "notes": list(fit.notes)}  # fmt: skip


@case("fit.rotor", quick=True)
def _rotor() -> Any:
    loads = api("corrected_loads")(api("read_bench")("bench.csv"), None)
    fits = api("fit_rotor")(loads, radius_m=0.06, density_kg_m3=1.2)
    return [{"estimates": [fields(e) for e in f.estimates], "notes": list(f.notes)} for f in fits]


@case("fit.demo")
def _fit_demo() -> Any:
    demo = api("run_demo")(seed=1)
    fit = demo.fit
    return {
        "estimates": [fields(e) for e in fit.estimates],
        "correlation": np.asarray(fit.correlation),
        "undetermined": list(fit.undetermined),
        "cost": float(fit.cost),
        "simulations": fit.simulations,
        "held_out_over_noise": demo.held_out_over_noise,
        "records": [{"name": r.name, "error": np.asarray(r.rms_over_noise())} for r in fit.records],
    }


@case("fit.linear")
def _fit_linear() -> Any:
    record = api("read_columns")("sticks.csv")
    r = api("identify_linear")(
        record, {"lat": "lat", "lon": "lon"}, {"p": "p", "q": "q"}, model="hybrid-coupled", starts=2, seed=1
    )
    return {
        "estimates": [fields(e) for e in r.fit.estimates],
        "poles": np.asarray(r.linear_fit.poles).view(float),
        "quality": {k: [fields(c.quality) for c in v] for k, v in r.checks.items()},
        "missing": list(r.model_deficiencies),
        "message": r.linear_fit.message,
    }


def bladed(name: str, **options: Any) -> Any:
    return api("prepare")(api("load_rotor")(name), **options)


COARSE_WAKE = {"chord_deg": 15.0, "turns": 2.0, "far_turns": 6.0, "tolerance": 0.01}


def solved(solution: Any) -> Any:
    return {
        "rotors": [fields(r) for r in solution.rotors],
        "history": np.asarray(solution.history),
        "converged": solution.converged,
        "message": solution.message,
        "iterations": solution.iterations,
        "residual": solution.residual,
    }


def rotor_system(
    bladings: Any, pitch: Any, speed: Any, method: str = "bemt", *, spacing_m: float = 0.02,
    settings: Any = None, **given: Any,
) -> Any:  # fmt: skip
    """One rotor, or a pair, at a point."""
    make = api("System")
    system = (
        make.from_coaxial_pair(*bladings, spacing_m=spacing_m)
        if isinstance(bladings, tuple)
        else make.from_single_rotor(bladings)
    )
    return api("solve")(system, api("Condition")(pitch, speed, **given), method, settings=settings)


@case("wake.single")
def _wake_single() -> Any:
    blades, s = bladed("naca0012-r60-c20", stations=10), api("WakeSettings")(**COARSE_WAKE)
    out = {}
    for model in ("free", "prescribed"):
        settings = api("WakeSettings")(model=model, **COARSE_WAKE)
        out[model] = solved(rotor_system(blades, 0.21, 520.0, "wake", settings=settings))
    out["climb"] = solved(rotor_system(blades, 0.25, 520.0, "wake", climb_m_s=1.0, settings=s))
    return out


@case("wake.pair")
def _wake_pair() -> Any:
    blades, s = bladed("naca0012-r60-c20", stations=10), api("WakeSettings")(**COARSE_WAKE)
    return solved(rotor_system((blades, blades), (0.24, 0.23), (600.0, 650.0), "wake", settings=s))


@case("bemt.single", quick=True)
def _bemt_single() -> Any:
    out = {}
    for name in ("naca4412-r60-c20", "walkera-5g6"):
        blades = bladed(name)
        out[name] = fields(api("hover")(blades, pitch_rad=0.2, speed_rad_s=480.0))
        out[f"{name} climbing"] = fields(api("hover")(blades, pitch_rad=0.2, speed_rad_s=480.0, climb_m_s=1.0))
        out[f"{name} at thrust"] = fields(api("solve_thrust")(blades, thrust_N=0.2, pitch_rad=0.22))
        batch = api("hover_batch")(blades, pitch_rad=[0.1, 0.2, 0.3], speed_rad_s=[400.0, 500.0, 600.0])
        out[f"{name} batch"] = fields(batch)
    return out


@case("bemt.coaxial", quick=True)
def _bemt_coaxial() -> Any:
    a, b = bladed("naca0012-r60-c20"), bladed("naca4412-r60-c20")
    out = {}
    for name, speed, given in (
        ("hover", (600.0, 620.0), {}),
        ("climb", (600.0, 620.0), {"climb_m_s": 1.0}),
        ("balanced", (600.0, None), {}),
        ("balanced at thrust", None, {"thrust_N": 0.8}),
    ):
        r = rotor_system((a, b), (0.24, 0.2), speed, **given)
        whole = ("thrust_N", "power_W", "yaw_torque_Nm", "figure_of_merit")
        pair = {k: getattr(r, k) for k in whole} | {"turns": r.iterations, "sent_up_m_s": r.coupling_variables[0]}
        out[name] = {"pair": pair, "upper": fields(r.upper), "lower": fields(r.lower)}
    return out


@case("design")
def _design() -> Any:
    c = api("design")(api("load_vehicle")("mufly-1.1"))
    out: dict[str, Any] = {"told": api("to_plain_data")(c)}
    for name in ("heave_yaw", "roll_pitch", "velocity"):
        one = getattr(c, name)
        for label, system in (("controller", one.controller), ("reduced", one.reduced)):
            out[f"{name} {label}"] = {k: array(np.asarray(getattr(system, k), dtype=float)) for k in "ABCD"}
    return out


@case("dynamics")
def _dynamics() -> Any:
    out: dict[str, Any] = {}
    for name in ("mufly-1.1", "mufly-2.0"):
        v = api("load_vehicle")(name)
        t = api("trim_state")(v)
        out[f"{name} trim"] = fields(t)
        lin = api("linearise")(v)
        out[f"{name} linear"] = fields(lin)
        out[f"{name} hover"] = fields(api("hover_performance")(v))
        p = api("model_parameters")(v)
        out[f"{name} parameters"] = {n: np.asarray(p[n]) for n in p.dtype.names}
        flight = api("simulate")(
            v, t.state, np.add(t.input, [0.02, 0.01, 0.1, -0.05]), duration_s=1.0, wind=[0.5, 0.2, 0.0]
        )
        out[f"{name} open loop"] = dataset(flight)
    return out


# --- errors -----------------------------------------------------------------------------------------------------------

WRONG = """
vehicle show nowhere
vehicle show bad_vehicle.toml
vehicle check broken.toml
mission show typo.toml
mission check wall.toml
mission check broken.toml
mission show nowhere.toml
control design --rate 5
drive show --rotor naca0012-r60-c20 --thrust 0.3
drive show bad_drive.toml --thrust 0.3
drive show --rotor upper --pitch 12
drive sweep --gear 8:1:1
rotor show nowhere
rotor show bad_rotor.toml
rotor show --rpm -5
rotor hover --pitch 12
rotor hover --pitch twelve --rpm 5000
rotor hover --pitch 12 --rpm 5000 --model best
rotor hover --pitch 12 --rpm 5000 --engine cfd
rotor hover --pitch 12 --rpm 5000 --method cfd --band 0.9
rotor hover --pitch 12 --rpm 5000 --drive nowhere
rotor compare naca0012-r60-c20 nothing.csv
rotor compare naca0012-r60-c20 bad_bench.csv
rotor sweep
rotor sweep --vary chord=1:2:1 --set speed=5000rpm
rotor sweep --vary pitch=6:8:1deg --set thrust=0.1,0.2N
rotor sweep --vary pitch=6:8:1deg --set speed=5000rpm --plot beauty
rotor rank --airfoils nowhere
rotor optimise --free everything
rotor optimise --limit colour<=3
coax hover --spacing 3mm
coax hover --spacing 20
coax hover --rpm 1,2,3
coax hover --method magic
coax hover --method bemt --wake prescribed
coax hover --wake-set step_deg=90
coax hover --wake-set nothing=1
coax trim --thrust -1
coax trim --thrust 0.5 --rpm 6000
coax trim --free lower-pitch --pitch 14,12
coax sweep
coax sweep --vary spacing=10mm --plot beauty
coax optimise --vary everything
coax map --ratio 1:2
identify motor nothing.csv
identify motor bench.csv
identify motor motor_bench.csv --gear fast
identify motor motor_bench.csv --gear-efficiency 1.5
identify motor motor_bench.csv --write new.toml
identify motor motor_bench.csv --noise heat=1%
identify motor motor_bench.csv --column abc
identify rotor bench.csv
identify rotor bench.csv --radius -1
identify rotor bench.csv --radius 0.06 --as middle
identify rotor bench.csv --radius 0.06 --column b=a
identify plan mufly-1.1 --free Xyz
identify plan mufly-1.1 --free cT_dw --channel sideways
identify plan mufly-1.1 --free cT_dw --kind loud
identify plan mufly-1.1 --free cT_dw --duration 1
identify plan mufly-1.1 --free cT_dw --band 3:0.1
identify plan mufly-1.1 --free cT_dw --limit motor=0.7
identify plan mufly-1.1 --free cT_dw --amplitude 3
identify plan mufly-1.1 --free cT_dw --noise depth=1
identify linear nothing.csv
identify linear sticks.csv --inputs lat,col --outputs p
identify linear sticks.csv --inputs lat,wheel --outputs p
identify linear sticks.csv --inputs lat --outputs p,zz
identify linear sticks.csv --inputs lat --outputs p --model clever
identify linear sticks.csv --inputs lat --outputs p --split 3
identify linear sticks.csv --inputs lat --outputs p --split 0.01
identify linear sticks.csv --inputs lat --outputs p --column a,b
identify linear sticks.csv --inputs lat --outputs p --from 3 --to 4
identify flight nothing.mcap --free l_up
identify flight waves.csv --free l_up
identify flight waves.csv --free l_up --method simplex
identify flight waves.csv --free l_up --part roll
identify flight waves.csv --free l_up --delay -5
identify flight waves.csv --free l_up --window 0
identify flight waves.csv --free l_up --out nowhere/new.toml
identify demo --method simplex
log info nothing.mcap
log info hop.toml
log info waves.csv -c nonsense
log info waves.csv -c measured_rates.p=nowhere
log plot waves.csv --from 5 --to 2
log plot waves.csv nothing
log convert waves.csv waves.doc
log convert waves.csv bench.csv
log convert waves.csv out.csv --from 5 --to 2
log convert waves.csv out.csv --from 50 --to 60
thesis run fig-1.1
thesis run fig-9.9
thesis run all --case nothing
thesis run fig-3.23 --case nothing
fly nowhere --headless
fly --headless --wind 1,2
fly --headless --gust 99
fly --headless --seed -1
fly hop.toml --vehicle nowhere --headless
fly wall.toml --headless
fly hop.toml --link udp:nowhere --headless
fly hop.toml --link udp:127.0.0.1:14550 --link udp:127.0.0.1:14550
fly hop.toml --out hop.toml --headless
fly hop.toml --token short
link --system 300
link --link carrier:pigeon
link --origin 1,2
link --link udp:127.0.0.1:14550 --link udp:127.0.0.1:14550
station --connect serial:
station --open nothing.mcap
station --mission nowhere
station --out hop.toml
nonsense
rotor nonsense
rotor hover --nonsense
rotor hover --rpm fast
""".strip().splitlines()


@case("errors.command", quick=True)
def _errors() -> Any:
    """What a wrong command line or file is answered with: status and the line on standard error."""
    found = {}
    for words in WRONG:
        status, out, err = run(*words.split())
        found[words] = [status, *text_of(err)[-3:], *(["printed something"] if out.strip() else [])]
    return found


def wrong_calls() -> dict[str, Callable[[], Any]]:
    """Wrong arguments of the library, across the rooms."""
    v = api("load_vehicle")("mufly-1.1")
    blades = bladed("naca4412-r60-c20")
    thesis = api("load_rotor")("naca0012-r60-c20")
    names = {"lat": "lat"}, {"p": "p"}
    return {
        "vehicle": lambda: api("load_vehicle")("nowhere"),
        "mission": lambda: api("load_mission")("typo.toml"),
        "rotor": lambda: api("load_rotor")("nowhere"),
        "drive": lambda: api("load_drive")("nowhere"),
        "map": lambda: api("load_coefficient_map")("nowhere"),
        "hover speed": lambda: api("hover")(blades, pitch_rad=0.2, speed_rad_s=-1.0),
        "hover nan": lambda: api("hover")(blades, pitch_rad=math.nan, speed_rad_s=400.0),
        "hover climb": lambda: api("hover")(blades, pitch_rad=0.2, speed_rad_s=400.0, climb_m_s=-9.0),
        "thrust both": lambda: api("solve_thrust")(blades, thrust_N=0.3, pitch_rad=0.2, speed_rad_s=400.0),
        "thrust none": lambda: api("solve_thrust")(blades, thrust_N=0.3),
        "thrust too much": lambda: api("solve_thrust")(blades, thrust_N=1e4, pitch_rad=0.2),
        "stations": lambda: api("prepare")(thesis, stations=1),
        "n_crit": lambda: api("prepare")(thesis, n_crit=-3.0),
        "coaxial spacing": lambda: rotor_system((blades, blades), 0.2, 500.0, spacing_m=0.0),
        "balance": lambda: rotor_system((blades, blades), 0.2, None),
        "interval": lambda: api("interval")(thesis, pitch_rad=0.2, speed_rad_s=500.0, level=3.0),
        "wake step": lambda: api("WakeSettings")(step_deg=90.0),
        "wake turns": lambda: api("WakeSettings")(turns=-1.0),
        "wake close": lambda: rotor_system((blades, blades), 0.2, 500.0, "wake", spacing_m=0.001),
        "design rate": lambda: api("design")(v, rate_Hz=5.0),
        "fly wind": lambda: api("fly")(v, "hop.toml", wind=[1.0, 2.0]),
        "fly gust": lambda: api("fly")(v, "hop.toml", gust=-1.0),
        "free": lambda: api("choose_free")(v, ["nothing"], ["yaw"]),
        "free none": lambda: api("choose_free")(v, [], ["yaw"]),
        "free twice": lambda: api("choose_free")(v, ["Izz", "Izz"], ["yaw"]),
        "free bias": lambda: api("choose_free")(v, ["bias_p"], ["yaw"]),
        "excitation kind": lambda: api("excitation")("loud", duration_s=5.0, band_rad_s=(1.0, 9.0), sample_s=0.01),
        "plan channel": lambda: api("plan")(v, ["Izz"], "sideways"),
        "linear split": lambda: api("identify_linear")(api("read_columns")("sticks.csv"), *names, split=9.0),
        "linear model": lambda: api("identify_linear")(api("read_columns")("sticks.csv"), *names, model="x"),
        "linear names": lambda: api("identify_linear")(api("read_columns")("sticks.csv"), {"zz": "lat"}, {"p": "p"}),
        "fit rotor": lambda: api("fit_rotor")(
            api("corrected_loads")(api("read_bench")("bench.csv"), None), radius_m=-1.0
        ),
        "bench": lambda: api("read_bench")("bad_bench.csv"),
        "bench columns": lambda: api("read_bench")("bench.csv", columns=["y=x"]),
        "log": lambda: api("read_log")("nothing.ulg"),
        "log part": lambda: api("read_log")("waves.csv", from_s=9.0, to_s=1.0),
        "endpoint": lambda: api("parse_endpoint")("pigeon:1", "vehicle"),
        "origin": lambda: api("parse_global_origin")("1,2"),
        "study": lambda: api("run_study")("fig-0.0"),
        "setup": lambda: api("evaluate")(api("Setup")(thesis, None, {"speed": 500.0}), [{"pitch": math.nan}]),
    }  # fmt: skip


@case("errors.library", quick=True)
def _wrong_calls() -> Any:
    from mufly import MuflyError

    found = {}
    for name, call in wrong_calls().items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call()
            found[name] = "no error"
        except MuflyError as error:
            found[name] = f"{type(error).__name__}: {error}"
        except Exception as error:
            found[name] = f"{type(error).__name__}! {str(error).splitlines()[0] if str(error) else ''}"
        found[name] = found[name].replace(str(Path.cwd()), "HERE")
    return found


# --- freezing and checking --------------------------------------------------------------------------------------------


def now(name: str) -> Any:
    """A case's answer as it would be frozen; if it cannot be had, why."""
    with workplace():
        try:
            return json.loads(json.dumps(written(CASES[name]())))
        except Exception:
            return {"BROKEN": traceback.format_exc().splitlines()[-6:]}


def place_of(name: str) -> Path:
    return HERE / f"{name.split('.')[0]}.json"


def frozen() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for file in sorted(HERE.glob("*.json")):
        found |= json.loads(file.read_text(encoding="utf-8"))
    return found


_WORDS = re.compile(r"\s+")


def _same_text(a: str, b: str, digits: int | None) -> bool | None:
    """True: equal; None: only numbers beyond the digits or hashes differ; False: different."""
    if a == b:
        return True
    first, second = _WORDS.split(a), _WORDS.split(b)
    if len(first) != len(second):
        return False
    for x, y in zip(first, second, strict=True):
        if x == y or (x[:1] == "#" == y[:1]):
            continue
        try:
            p, q = float(x), float(y)
        except ValueError:
            return False
        if not _near(p, q, digits):
            return False
    return None


def _near(p: float, q: float, digits: int | None) -> bool:
    return p == q or (p != p and q != q) or abs(p - q) <= 10.0 ** -(digits or 8) * max(abs(p), abs(q)) + 1e-13


def differences(a: Any, b: Any, path: str = "", digits: int | None = None) -> Iterator[tuple[str, bool]]:
    """Lines that say where two answers differ, each with whether it is only the last bits.

    With ``digits``, numbers are compared to so many and hashes not at all.
    """
    if isinstance(a, dict) and isinstance(b, dict):
        inner = 0
        for key in dict.fromkeys([*a, *b]):
            if key == "#":
                continue
            if key not in a:
                yield f"{path}.{key}: new, {str(b[key])[:120]}", False
            elif key not in b:
                yield f"{path}.{key}: gone, was {str(a[key])[:120]}", False
            else:
                for found in differences(a[key], b[key], f"{path}.{key}", digits):
                    inner += 1
                    yield found
        if digits is None and not inner and a.get("#") != b.get("#"):
            yield f"{path}: numbers", True
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield f"{path}: {len(a)} entries, now {len(b)}: {str(a)[:150]} -> {str(b)[:150]}", False
            return
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from differences(x, y, f"{path}[{k}]", digits)
    elif isinstance(a, str) and isinstance(b, str):
        same = _same_text(a, b, digits)
        if same is not True and not (digits is not None and same is None):
            yield f"{path}: {a!r} -> {b!r}", same is None
    elif isinstance(a, int | float) and isinstance(b, int | float) and not isinstance(a, bool):
        if a != b and not (digits is not None and _near(a, b, digits)):
            yield f"{path}: {a} -> {b}", _near(a, b, None)
    elif a != b:
        yield f"{path}: {str(a)[:150]} -> {str(b)[:150]}", False


def chosen(only: str | None) -> list[str]:
    words = [w for w in (only or "").split(",") if w]
    return [n for n in CASES if not words or any(w in n for w in words)]


def timed(name: str) -> tuple[str, Any, float]:
    start = time.perf_counter()
    return name, now(name), time.perf_counter() - start


def answers(names: list[str], processes: int) -> Iterator[tuple[str, Any, float]]:
    if processes < 2 or len(names) < 3:
        yield from map(timed, names)
        return
    slow_first = sorted(names, key=lambda n: n in QUICK)
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(timed, slow_first)


def freeze(only: str | None, processes: int) -> int:
    kept = {n: v for n, v in frozen().items() if n in CASES}
    broken = 0
    for name, value, seconds in answers(chosen(only), processes):
        kept[name] = value
        broken += "BROKEN" in value
        print(f"{name}: {seconds:.1f} s{'  BROKEN: ' + str(value) if 'BROKEN' in value else ''}", flush=True)
    files: dict[Path, dict[str, Any]] = {}
    for name in CASES:
        if name in kept:
            files.setdefault(place_of(name), {})[name] = kept[name]
    for file, content in files.items():
        file.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{sum(f.stat().st_size for f in files) / 1e3:.0f} kB in {len(files)} files")
    return 1 if broken else 0


def check(only: str | None, processes: int, most: int) -> int:
    kept = frozen()
    wrong, bits = [], []
    for name, value, seconds in answers(chosen(only), processes):
        if name not in kept:
            print(f"{name}: never frozen")
            wrong.append(name)
            continue
        found = list(differences(kept[name], value))
        if not found:
            print(f"{name}: as it was ({seconds:.1f} s)", flush=True)
            continue
        only_bits = all(last for _, last in found)
        (bits if only_bits else wrong).append(name)
        print(f"{name}: {'LAST BITS' if only_bits else 'DIFFERENT'}, {len(found)} places ({seconds:.1f} s)")
        for line, last in sorted(found, key=lambda f: f[1])[:most]:
            print(f"    {'(last bits) ' if last else ''}{line[:400]}", flush=True)
    total = len(chosen(only))
    print(f"{total - len(wrong) - len(bits)} of {total} as they were; "
          f"last bits: {', '.join(bits) or 'none'}; different: {', '.join(wrong) or 'none'}")  # fmt: skip
    return 1 if wrong or bits else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=("freeze", "check", "list"))
    parser.add_argument("--only", metavar="WORD[,WORD]", help="cases with this in their name")
    parser.add_argument("--processes", type=int, default=2, choices=(1, 2))
    parser.add_argument("--most", type=int, default=12, help="lines told of each case that differs")
    given = parser.parse_args()
    if given.what == "list":
        print("\n".join(f"{n}{'  (quick)' if n in QUICK else ''}" for n in chosen(given.only)))
        return 0
    if given.what == "freeze":
        return freeze(given.only, given.processes)
    return check(given.only, given.processes, given.most)


if __name__ == "__main__":
    sys.exit(main())
