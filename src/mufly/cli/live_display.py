"""What a flight shows in the terminal: its events as lines, and on a terminal a live line below them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from mufly.logs.layout import Event

__all__ = ["LiveDisplay"]


class LiveDisplay:
    """Events and notices as lines, and a live line below them, while it is open.

    Parameters
    ----------
    console : Console
        Without a terminal there is no live line.
    """

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self._console = console
        self._live = Live(console=console, refresh_per_second=10) if console.is_terminal else None

    def __enter__(self) -> LiveDisplay:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._live is not None:
            self._live.update("")
            self._live.__exit__(None, None, None)

    def event(self, e: Event) -> None:
        """Show an event of the flight."""
        from rich.text import Text

        colour = {"error": "red", "warning": "yellow"}.get(e.level, "default")
        line = Text(f"{e.time_s:7.1f} s  ").append(f"{e.state:<9}  ", style="bold")
        self._console.print(line.append(e.text, style=colour), highlight=False)

    def notice(self, text: str) -> None:
        """Show what happened beside the flight, to a port for example."""
        from rich.text import Text

        self._console.print(Text(text, style="dim"), highlight=False)

    def now(self, line: str) -> None:
        """Put this into the live line."""
        if self._live is not None:
            from rich.text import Text

            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"))
