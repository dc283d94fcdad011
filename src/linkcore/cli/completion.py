"""`completion`: the script with which a shell completes commands, options and the names that they take.

It is made from the parsers of all commands; a shell that has read it starts no program to complete a word.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator

from .options import argument, command, completed_words

#: zsh runs the functions of bash after this.
_ZSH = "autoload -U +X compinit && compinit -u\nautoload -U +X bashcompinit && bashcompinit\n"


@command(
    "completion",
    "complete words in bash and zsh",
    argument("shell", choices=("bash", "zsh"), help="whose lines to print"),
)
def run(args: argparse.Namespace) -> int:
    """Print the lines by which a shell completes commands, options, and the names that a command takes, such as RTDE
    variables. They belong into the file that the shell reads when it starts.

    examples:
      {program} completion bash >> ~/.bashrc
      {program} completion zsh >> ~/.zshrc
      {program} completion bash > ~/.local/share/bash-completion/completions/{program}
    """
    parser: argparse.ArgumentParser = args.all_commands()
    print((_ZSH if args.shell == "zsh" else "") + _script(parser), end="")
    return 0


def _script(parser: argparse.ArgumentParser) -> str:
    """The function of bash that completes the commands of a program."""
    commands = next(each.choices for each in parser._actions if isinstance(each, argparse._SubParsersAction))
    function = "_" + re.sub(r"\W", "_", parser.prog)
    lines = [
        f"{function}() {{",
        '  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}"',
        '  local command="${COMP_WORDS[1]}" words=""',
        f'  if [ "$COMP_CWORD" -eq 1 ]; then words="{_joined([*commands, "--help", "--version"])}"',
        '  else case "$command $before" in',
        *(f'    "{name} {option}") words="{_joined(choices)}" ;;' for name, option, choices in _values(commands)),
        '    *) case "$command" in',
        *(f'      {name}) words="{_joined(_words(each))}" ;;' for name, each in commands.items()),
        "    esac ;;",
        "  esac; fi",
        '  COMPREPLY=($(compgen -W "$words" -- "$word"))',
        "}",
        f"complete -o default -F {function} {parser.prog}",
    ]
    return "\n".join(lines) + "\n"


def _joined(words: Iterable[str]) -> str:
    """Words that a shell takes as they are; others, with blanks, are left out."""
    return " ".join(word for word in words if re.fullmatch(r"[\w.:/=+-]+", word))


def _values(commands: dict[str, argparse.ArgumentParser]) -> Iterator[tuple[str, str, list[str]]]:
    """Command, option, and the values that the option takes; none for one that takes anything."""
    for name, parser in commands.items():
        for action in parser._actions:
            if action.option_strings and action.nargs != 0:
                for option in action.option_strings:
                    yield name, option, list(completed_words(action))


def _words(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The options of a command, and the words that its other arguments take."""
    for action in parser._actions:
        if action.option_strings:
            yield from action.option_strings
        else:
            yield from completed_words(action)
