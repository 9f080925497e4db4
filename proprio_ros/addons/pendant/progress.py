"""What goes on, as every page shows it: its title, how far it is, what it says, and in the end its command to copy."""

from __future__ import annotations

from html import escape

from nicegui import ui

from proprio_ros.addons.pendant.calls import Call

READS_S = 0.5
LATEST = 4
"""So many sentences are shown."""
COPIES = "() => navigator.clipboard.writeText(event.target.closest('section').querySelector('.command').innerText)"


class Progress:
    """A card about the latest call; who shows one fills `answer` when it changes.

    Args:
        name: Of the card.
    """

    def __init__(self, name: str) -> None:
        self._shown: tuple[Call | None, bool] = (None, False)
        with ui.element("section").classes("card progress") as self.card:
            self.card.props(f'aria-label="{name}"')
            self._title = ui.label().classes("title")
            self.bar = ui.linear_progress(0.0, show_value=False).props('aria-label="Working"')
            self._said = ui.html().props("role=status")
            self.answer = ui.element("div").classes("hand").props('role="status"')
            self._command = ui.label().classes("command")
            copy = ui.button("Copy the command").props("flat no-caps")
            copy.on("click", js_handler=COPIES)

    def read(self, call: Call | None, title: str, doing: str, runs: bool) -> bool:
        """Show how it is; whether a call has begun, or ended, since.

        Args:
            call: The latest.
            title: What it does.
            doing: How far it is, while it runs.
            runs: Whether it does.
        """
        self.card.set_visibility(call is not None)
        if call is None:
            return False
        self._title.set_text(f"{title}: {doing}, {call.elapsed_s:.0f} s" if runs else title)
        said = "".join(f"<p>{escape(words)}</p>" for words in call.said[-LATEST:])
        self._said.set_content(f'<div class="said">{said}</div>' if runs else "")
        self.bar.set_visibility(runs)
        self._command.set_text(call.command)
        changed = (call, runs) != self._shown
        self._shown = (call, runs)
        if changed:
            self.answer.clear()
        return changed
