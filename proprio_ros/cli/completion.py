"""Completion of the command line by shells: a script for each, made from the parser, which needs nothing installed."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator

from proprio_ros.inputs.resources import resource_names

SHELLS = ("bash", "zsh", "fish")
NAMES = {"--robot": "robots", "--driver": "drivers"}
"""Options that take a file of the package by its name, or any other file."""
BASH = """_proprio() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} command=${{COMP_WORDS[1]}} words=
    [[ $command == robot ]] && command="robot ${{COMP_WORDS[2]}}"
    if (( COMP_CWORD == 1 )); then
        words={commands}
    elif (( COMP_CWORD == 2 )) && [[ ${{COMP_WORDS[1]}} == robot ]]; then
        words=new
    else
        case "$command $before" in
{values}
            *) [[ $current == -* ]] && case "$command" in
{options}
            esac ;;
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _proprio proprio
"""
ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
"""Before the script for bash, which zsh then understands."""


def script(shell: str, parser: argparse.ArgumentParser) -> str:
    """What a shell has to read, for instance ``source <(proprio completion bash)``."""
    commands = dict(_commands(parser))
    if shell == "fish":
        return "".join(_fish(commands))
    values = []
    options = []
    for name, command in commands.items():
        named = [
            (action, action.option_strings[-1])
            for action in command._actions
            if action.option_strings
        ]
        options.append(
            f'                "{name}") words={shlex.quote(" ".join(flag for _, flag in named))} ;;'
        )
        for action, flag in named:
            words = _values(action, flag)
            if words:
                values.append(
                    f'            "{name} {flag}") words={shlex.quote(" ".join(words))} ;;'
                )
    first = shlex.quote(" ".join(dict.fromkeys(name.partition(" ")[0] for name in commands)))
    text = BASH.format(
        commands=first,
        values="\n".join(values),
        options="\n".join(options),
    )
    return ZSH * (shell == "zsh") + text


def _commands(
    parser: argparse.ArgumentParser, before: str = ""
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Parsers by the words that lead to them; of a command with commands of its own, those."""
    for group in (
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ):
        for name, command in group.choices.items():
            yield from list(_commands(command, f"{before}{name} ")) or [
                (f"{before}{name}", command)
            ]


def _values(action: argparse.Action, flag: str) -> tuple[str, ...]:
    return tuple(map(str, action.choices or ())) or (
        resource_names(NAMES[flag]) if flag in NAMES else ()
    )


def _fish(commands: dict[str, argparse.ArgumentParser]) -> Iterator[str]:
    for name, command in commands.items():
        first, _, second = name.partition(" ")
        about = shlex.quote((command.description or "").partition(".")[0])
        yield f"complete -c proprio -n __fish_use_subcommand -a {first} -d {about}\n"
        if second:
            yield f"complete -c proprio -n '__fish_seen_subcommand_from {first}' -a {second}\n"
        for action in command._actions:
            for flag in (flag for flag in action.option_strings if flag.startswith("--")):
                words = (
                    f" -a {shlex.quote(' '.join(values))}"
                    if (values := _values(action, flag))
                    else ""
                )
                takes = "" if action.nargs == 0 else " -x" if action.choices else " -r"
                yield f"complete -c proprio -n '__fish_seen_subcommand_from {first}' -l {flag[2:]}{takes}{words}\n"
