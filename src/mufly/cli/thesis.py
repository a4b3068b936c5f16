"""``mufly thesis``: repeat the dissertation's studies, ours beside theirs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli.options import Commands, JsonOption, argument, option
from mufly.cli.present import console, print_json, print_table, progress_bar

if TYPE_CHECKING:
    from mufly.thesis import Outcome

app = Commands(
    help="Repeat the studies of the dissertation and say where we agree with it. What each assumes: docs/studies.md.",
    no_args_is_help=True,
)


@app.command("list")
def list_studies(as_json: JsonOption = False) -> None:
    """List the studies that can be repeated."""
    from mufly.thesis import studies

    if as_json:
        print_json([vars(s) for s in studies()])
        return
    print_table(
        ("name", "section", "title"), [(s.name, s.section, s.title) for s in studies()], text=(0, 1, 2)
    )


@app.command()
def run(
    name: Annotated[str, argument("NAME|all", "A study that `mufly thesis list` names, or all.")],
    out: Annotated[Path | None, option("--out DIR", "Write picture, tables and verdicts there.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a study: a line for every claim of the dissertation, with our numbers and the rule of agreement.

    Each study is computed with our corrections and with the theory as the dissertation has it, so that a
    difference can be traced to the one or the other.

    Examples: mufly thesis run fig-3.26; mufly thesis run all --out thesis
    """
    from mufly.thesis import run_study, studies

    names = [s.name for s in studies()] if name == "all" else [name]
    answers: list[dict[str, Any]] = []
    for one in names:
        with progress_bar(one, not as_json) as progress:
            outcome = run_study(one, progress)
        files = outcome.write(out) if out is not None else []
        answers.append({**outcome.to_dict(), "files": [str(f) for f in files]})
        if not as_json:
            _print(outcome, files)
    if as_json:
        print_json(answers if name == "all" else answers[0])
    elif name == "all":
        every = [v["agrees"] for a in answers for v in a["verdicts"]]
        console().print(f"[bold]{sum(every)} of {len(every)} verdicts agree.[/bold]")


def _print(outcome: Outcome, files: list[Path]) -> None:
    c = console()
    c.print(f"[bold]{outcome.name}[/bold]  {outcome.title}", highlight=False)
    for verdict in outcome.verdicts:
        c.print(
            f"  {verdict.line()}", style=None if verdict.agrees else "yellow", highlight=False, markup=False
        )
    if not outcome.verdicts:
        c.print("  contours only; --out draws them", style="dim")
    for file in files:
        c.print(f"  Written: {file}", style="dim", highlight=False)
