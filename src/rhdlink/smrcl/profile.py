"""The two profiles: "mrc" does what the original does, "sound" what a mission may expect.

Each difference is one field of `Profile`, with what the original does and what is done instead; the table in the
documentation is made of them. What no script can want (crashes, endless loops inside of MRC, memory that is overrun)
is bounded under both profiles, see `BOTH`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from linkcore.errors import BadValue


def _fixed(mrc: str, sound: str) -> Any:
    return field(default=True, metadata={"mrc": mrc, "sound": sound})


@dataclass(frozen=True)
class Profile:
    """How a mission is executed: `MRC`, `SOUND`, or a mixture by `dataclasses.replace`.

    Attributes:
        name: "mrc" or "sound".
    """

    name: str = "sound"

    # -- motions
    turnr_ends: bool = _fixed(
        "`turnr`, `turnc` and `drivetopoint` end as a step of the script; the motion goes on until another one begins",
        "they stop the robot, unless the next line is a motion: then it begins at the speed that the robot has",
    )
    stop_stands: bool = _fixed(
        "`stop` leaves a velocity-omega robot its turn rate, and drives it by the error of its heading",
        "it stands, and holds its heading",
    )
    turn_ramps: bool = _fixed(
        "`turn` at a negative speed ramps from the robot's speed through 0 to it, and turns by its amount",
        "the sign of the speed does not matter to `turn`",
    )
    full_turns: bool = _fixed(
        "`turn` normalises its angle, so that 270 is -90, and never ends if the heading passes 180 degrees between two "
        "cycles",
        "it turns by the whole angle, and ends wherever the heading wraps",
    )
    topoint_is_signed: bool = _fixed(
        "an arc of `drivetopoint` ends when it has turned far enough to either side, so that a short backward arc ends "
        "at once if the robot still rolls forward; the last direction stays in the speed, and the length of the last "
        "`fwd` displaces the straight piece",
        "arcs count with their sign, the speed is what it was, and the straight piece lies where it was planned",
    )
    topoint_evaluates: bool = _fixed(
        "`setpar` of `evalmethod` has no effect (a double is written over an int)",
        "1 has `drivetopoint` take the shortest way that does not go backward",
    )
    white_edges: bool = _fixed(
        '`followline` with "wl" or "wr" drives straight on: the edges of a white line are not computed',
        "they are, as those of a black line",
    )
    stands_at_first: bool = _fixed(
        'before its first motion the robot holds its heading, so that `set "$odoth"` has it turn', "it stands"
    )
    counts_ticks: bool = _fixed(
        "an answer of the robot counts as one period, so that a stall of n ticks is taken for n times the speed, and "
        "for a fault beyond `maxtick`: then its way and its turn are lost",
        "the robot's `tick` tells how many periods it was",
    )
    velomega_steers: bool = _fixed(
        "`turnc`, `followline`, `followwall`, `motorcmds` and `align` set the speeds of wheels; a velocity-omega robot "
        "gets the left one as its speed and keeps its turn rate",
        "it gets the speed and the turn rate that follow from both wheels",
    )
    outputs_round_alike: bool = _fixed(
        "`setoutput` sends trunc(v + 0.5), so that -3 is sent as -2; wheel speeds are floor(v + 0.5), and speeds of a "
        "velocity-omega robot are truncated",
        "all are rounded to the nearest number, halves away from zero",
    )
    reads_uncalibrated: bool = _fixed(
        "line sensors without a calibration read 0: black everywhere", "they read their raw value over 255"
    )
    sees_without_ir: bool = _fixed(
        "an SMR without infrared sensors has an obstacle at 0 m and never moves",
        "a robot without such sensors has no obstacles",
    )

    # -- the language
    rem_excludes_divisor: bool = _fixed("`rem(3, 3)` is 3", "`rem(3, 3)` is 0")
    file_lines: bool = _fixed(
        "the number in an error counts the lines executed so far, passes of a loop included",
        "it is the line of the file",
    )
    checks_first: bool = _fixed(
        "an error in a script is found when its line is reached",
        "a script with an error in it does not begin; all of them are reported, with line and column",
    )
    says_why: bool = _fixed(
        "an error reads `syntax error in line : 3`; motions tell what they plan",
        "an error says what was wrong and what was expected; motions are silent",
    )
    ascii_only: bool = _fixed(
        "a character beyond ASCII ends its line, and has an error before it forgotten",
        "it is an error, but in texts and comments",
    )
    new_variables_read_on: bool = _fixed(
        "after the first assignment to a new variable the rest of the line is ignored, and if it begins with another "
        "new name, that one is made instead",
        "the line goes on",
    )
    indices_are_checked: bool = _fixed(
        "an assignment beyond an array is ignored, a value read there is a tiny number that counts as true, and `set` "
        "and `log` reach other variables",
        "the mission fails and says which index it was",
    )
    names_are_checked: bool = _fixed(
        "unknown names are ignored in `set`, `setoutput`, `setgain`, `setoffset`, `control`, `log` and `stream`, and "
        "complained of in `setpar`, `routeinput` and `routeoutput`",
        "the mission fails and says which name it was",
    )
    needs_are_checked: bool = _fixed(
        "`vision`, `laser` and `get` without a server, `play`, `speak` and other special hardware print a line or "
        "nothing, and the script goes on",
        "the mission fails unless it was given a function for them",
    )
    numbers_are_checked: bool = _fixed(
        "a motion takes a nan, an infinite length, and an acceleration that is not positive; a setting takes any "
        'number, and after `set "odowidth" 0` the heading is no number any more',
        "the mission fails and says which value it was",
    )
    knows_tick: bool = _fixed("`$tick` is 0", "`$tick` is the robot's count of ticks")
    knows_time: bool = _fixed(
        "`$time` is 0 on a robot whose time stands still between two exchanges (MRC's option `-s`)",
        "`$time` is the time that it has lived, s",
    )
    watches_apart: bool = _fixed(
        "there are two watches, further ones are ignored; a watch overwrites what `$condition` is made of",
        "there are up to 100, and they leave `$condition` alone",
    )

    # -- the server
    reads_input: bool = _fixed(
        "`read` waits for its conditions: nothing that a client sends ends it",
        "it ends with the next line of its client that is no immediate word; the line becomes the text `$str`",
    )
    client_loss_stops: bool = _fixed(
        "a client that vanishes leaves its commands running", "they are flushed, and the robot stops"
    )
    flush_stops: bool = _fixed(
        "`flushcmds` leaves the robot to the end of its motion, which may be never", "the robot stops"
    )


@dataclass(frozen=True)
class Difference:
    """One row of the table.

    Attributes:
        name: of the field of `Profile`.
        mrc: what the original does.
        sound: what is done instead.
    """

    name: str
    mrc: str
    sound: str


def differences() -> tuple[Difference, ...]:
    """Every difference between the two profiles."""
    return tuple(
        Difference(each.name, each.metadata["mrc"], each.metadata["sound"])
        for each in fields(Profile)
        if "mrc" in each.metadata
    )


#: What the original does that neither profile does: what MRC does, and what is done here.
BOTH: tuple[tuple[str, str], ...] = (
    ("a loop that takes no time never returns, and the robot goes on", "the mission fails after 20000 lines"),
    ("more than 1000 calls within calls, 10000 values or 49 parameters overrun memory", "the mission fails"),
    ("a text where a number is wanted, or the reverse, is read as the bytes that it is", "the line fails"),
    ("a speed that is no number is sent as -2147483648", "0 is sent, and what is too large is cut off"),
    ("`rem` and the angles of huge numbers take for ever", "they are reduced in one step"),
    ("`eval .` hangs, a name of more than 79 letters overruns memory", "the line fails"),
    (
        "a single `goto` from a client jumps into the plan that ran last, and MRC hangs behind its end",
        "it has no labels to go to, and fails",
    ),
    ("`stream 0` without xml ends MRC (division by zero)", "the values are sent once"),
    (
        "`followwall2` below 0.0052 m/s takes its gains from the memory before its table",
        "it takes those of the first row",
    ),
    (
        "killed, MRC leaves the robot with its last speeds",
        "see the robot's own rule; a turtle stops without its master",
    ),
)


SOUND = Profile()
MRC = Profile("mrc", **{each.name: False for each in differences()})
PROFILES = {profile.name: profile for profile in (MRC, SOUND)}


def find_profile(profile: Profile | str) -> Profile:
    """The profile of a name; a profile is itself.

    Raises:
        BadValue: there is none of that name.
    """
    if isinstance(profile, Profile):
        return profile
    if not isinstance(profile, str) or profile not in PROFILES:
        raise BadValue(f"compat={profile!r}; expected 'sound', 'mrc' or a Profile")
    return PROFILES[profile]
