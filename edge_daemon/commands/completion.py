"""`completion`: what a shell needs to complete commands and options, made from the parser itself."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

from edge_daemon import __version__


def completion(arguments: argparse.Namespace) -> None:
    """Prints a script for bash, which zsh reads after `bashcompinit`, or the manual page."""
    print(manual(arguments.known) if arguments.man else script(options_of(arguments.known)))


def script(options: Mapping[str, tuple[str, ...]]) -> str:
    """Bash: after a command its options, and files where none fits."""
    cases = "\n".join(f'    {name}) words="{" ".join(words)}" ;;' for name, words in options.items())
    return f"""\
# edge-daemon: source <(edge-daemon completion)
_edge_daemon() {{
  local words="{" ".join(options)} --help --version"
  if [ "$COMP_CWORD" -gt 1 ]; then
    case "${{COMP_WORDS[1]}}" in
{cases}
    *) words="" ;;
    esac
  fi
  COMPREPLY=( $(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}") )
}}
complete -o default -F _edge_daemon edge-daemon"""


def manual(commands: Mapping[str, argparse.ArgumentParser]) -> str:
    """A page for `man`: each command with its options, as their help says them."""
    lines = [f'.TH EDGE-DAEMON 1 "" "edge-daemon {__version__}"', ".SH NAME"]
    lines += [r"edge-daemon \- knows the state of a strain wave gear while it works", ".SH COMMANDS"]
    for command in commands.values():
        text = command.format_help().replace("\\", r"\e").replace("-", r"\-")
        body = "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in text.splitlines())
        lines += [f".SS {command.prog}", ".nf", body, ".fi"]
    return "\n".join([*lines, ".SH EXIT STATUS", "0 on success, 2 on bad input, which one line names."])


def options_of(commands: Mapping[str, argparse.ArgumentParser]) -> dict[str, tuple[str, ...]]:
    """Command -> its options and the words that it takes."""
    found: dict[str, tuple[str, ...]] = {}
    for name, command in commands.items():
        words = [word for row in command._actions for word in row.option_strings if word.startswith("--")]
        taken = [str(word) for row in command._actions if not row.option_strings for word in row.choices or ()]
        found[name] = (*taken, *words)
    return found
