"""The commands of log, streams, watches, events and texts; `commands` has the table of all."""

from __future__ import annotations

from .arithmetic import format_number, truncate
from .effects import MissionEffects, Watch, call_hook
from .expressions import LineFault
from .interpreter import Outcome, never
from .outbox import DataLog
from .symbols import split_index

#: Watches under the sound profile; MRC has two.
_MOST_WATCHES = 100


def log(effects: MissionEffects, *names: str) -> Outcome:
    """`log`: have variables logged in each cycle."""
    for text in names:
        if effects.log.columns >= DataLog.MOST_COLUMNS:
            effects.reject_name(f"a log has at most {DataLog.MOST_COLUMNS} variables", "logtable full\n")
            continue
        is_system = text[:1] == "$"
        name, index = split_index(text[1:] if is_system else text)
        symbol = effects.symbols.find_system(name) if is_system else effects.symbols.user.get(name)
        if symbol is None:
            effects.reject_name(f"there is no variable {text}")
            continue
        if effects.profile.indices_are_checked and not 0 <= index < symbol.size:
            raise LineFault(f"index {index} is beyond {name}, which has {symbol.size} values")
        if 0 <= symbol.place + index < len(effects.symbols.pool):
            effects.log.add(symbol.place + index)
    return effects.at_once()


def control_log(effects: MissionEffects, word: str, name: str = "log", unused: str = "") -> Outcome:
    """`control`: the log; it is saved as `name`."""
    if word == "stoplog":
        effects.log.is_on = False
    elif word == "startlog":
        effects.log.is_on = True
    elif word == "resetlog":
        effects.log.reset()
    elif word == "removelogvars":
        effects.log.remove_all()
    elif word == "savelog":
        effects.client.save_log(name, effects.log.text)
    else:
        effects.reject_name(f'control knows no word "{word}"')
    return effects.at_once()


def stream(effects: MissionEffects, period: float, *names: str) -> Outcome:
    """`stream`: send variables to the client, every `period` cycles."""
    variables = []
    for text in names:
        # MRC looks for both, a system variable behind the first character and a variable of the script.
        is_system = text[:1] == "$" or not effects.profile.names_are_checked
        system = effects.symbols.find_system(text[1:]) if is_system else None
        user = effects.symbols.user.get(text)
        if system is None and user is None:
            effects.reject_name(f"there is no variable {text}")
        variables += [(each.name, each.place) for each in (system, user) if each is not None]
    effects.client.stream(truncate(period), variables)
    return effects.at_once()


def add_watch(effects: MissionEffects, name: str, number: float) -> Outcome:
    """`addwatch`: an event whenever its condition becomes true."""
    most = _MOST_WATCHES if effects.profile.watches_apart else 2
    if len(effects.watches) < most:
        effects.watches.append(Watch(name if effects.profile.watches_apart else name[:31], effects.conditions))
    elif effects.profile.watches_apart:
        raise LineFault(f"there are {most} watches already", is_limit=True)
    return effects.at_once()


def put_event(effects: MissionEffects, name: str) -> Outcome:
    """`putevent`: an event that the client gets when it asks for one."""
    effects.client.user_event(name)
    return effects.go_on()


def sync_event(effects: MissionEffects, name: str) -> Outcome:
    """`syncevent`: one that the client is sent at once."""
    effects.client.sync_event(name)
    return effects.go_on()


def print_text(effects: MissionEffects, text: str) -> Outcome:
    """`print`: to the client."""
    effects.client.text(text)
    return effects.at_once()


def read(effects: MissionEffects, prompt: str) -> Outcome:
    """`read`: ask the client; its answer becomes the text buffer."""
    hook = effects.hooks.get("read")
    if hook is not None:
        answer = call_hook("read", hook, prompt)
        effects.set_text(str(answer))
        return effects.at_once()
    effects.client.text(prompt)
    if not effects.profile.reads_input:
        return effects.wait(never)
    if not effects.client.can_answer:
        raise LineFault('read needs an answer: give the mission a function for it, mission.on("read", function)')
    effects.is_reading = True
    return effects.wait(lambda: not effects.is_reading)


def join_texts(effects: MissionEffects, *parts: float | str) -> Outcome:
    """`stringcat`: into the text buffer."""
    texts = []
    for part in parts:
        if isinstance(part, str):
            texts.append(effects.text_buffer if part == "$str" else part)
        else:
            texts.append(f"{format_number(part)} ")
    return _keep_text(effects, "".join(texts))


def write_whole(effects: MissionEffects, value: float) -> Outcome:
    """`tointstring`: a number without its fraction, into the text buffer."""
    return _keep_text(effects, f"{truncate(value)} ")


def _keep_text(effects: MissionEffects, text: str) -> Outcome:
    effects.set_text(text)
    effects.output.message(f"strbuf {effects.text_buffer} \n")
    return effects.at_once()
