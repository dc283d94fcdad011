"""The command `completion`, which prints a shell script for completing commands, options and names.

The script is made from the parsers of all commands. A shell that has read the script can complete a word without
starting a program.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator

from .options import argument, command, completed_words

#: Lines after which zsh can run the completion functions of bash.
_ZSH = "autoload -U +X compinit && compinit -u\nautoload -U +X bashcompinit && bashcompinit\n"


@command(
    "completion",
    "complete words in bash and zsh",
    argument("shell", choices=("bash", "zsh"), help="shell for which to print the script"),
)
def run(args: argparse.Namespace) -> int:
    """Print a script with which a shell completes commands, options and names, such as RTDE variables. Append the
    script to the file that the shell reads when it starts.

    examples:
      {program} completion bash >> ~/.bashrc
      {program} completion zsh >> ~/.zshrc
      {program} completion bash > ~/.local/share/bash-completion/completions/{program}
    """
    parser: argparse.ArgumentParser = args.all_commands()
    print((_ZSH if args.shell == "zsh" else "") + _script(parser), end="")
    return 0


def _script(parser: argparse.ArgumentParser) -> str:
    """Return the bash function that completes the commands of a program."""
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
    """Join the words that do not need quotes in a shell.

    Other words, such as words with blanks, are left out.
    """
    return " ".join(word for word in words if re.fullmatch(r"[\w.:/=+-]+", word))


def _values(commands: dict[str, argparse.ArgumentParser]) -> Iterator[tuple[str, str, list[str]]]:
    """Yield each command, option, and the possible values of the option.

    The list of values is empty if any value is possible.
    """
    for name, parser in commands.items():
        for action in parser._actions:
            if action.option_strings and action.nargs != 0:
                for option in action.option_strings:
                    yield name, option, list(completed_words(action))


def _words(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the options of a command, and the possible words of its other arguments."""
    for action in parser._actions:
        if action.option_strings:
            yield from action.option_strings
        else:
            yield from completed_words(action)
