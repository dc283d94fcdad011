"""The two profiles: "mrc" behaves like the original, and "sound" behaves like the original without its defects.

Each difference is one field of `Profile`, with the behaviour of the original and of this library. The table in the
documentation is made from these fields. Behaviour that no script can need (crashes, endless loops inside MRC, overrun
memory) is prevented in both profiles; see `BOTH`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from linkcore.errors import BadValue


def _fixed(mrc: str, sound: str) -> Any:
    return field(default=True, metadata={"mrc": mrc, "sound": sound})


@dataclass(frozen=True)
class Profile:
    """Rules for executing a mission: `MRC`, `SOUND`, or a mixture.

    `dataclasses.replace` makes a mixture.

    Attributes:
        name: "mrc" or "sound".
    """

    name: str = "sound"

    # -- motions
    turnr_ends: bool = _fixed(
        "`turnr`, `turnc` and `drivetopoint` end as a step of the script; the motion continues until the next one",
        "they stop the robot; but if the next line is a motion, it begins at the current speed of the robot",
    )
    stop_stands: bool = _fixed(
        "`stop` keeps the turn rate of a velocity-omega robot, and sets its speed from its heading error",
        "the robot stops, and holds its heading",
    )
    turn_ramps: bool = _fixed(
        "`turn` at a negative speed ramps from the robot's speed through 0 to the negative speed, and turns at its "
        "magnitude",
        "`turn` ignores the sign of the speed",
    )
    full_turns: bool = _fixed(
        "`turn` normalises its angle, so that 270 is -90; it never ends if the heading passes 180 degrees between two "
        "cycles",
        "it turns by the whole angle, and ends even if the heading wraps",
    )
    topoint_is_signed: bool = _fixed(
        "an arc of `drivetopoint` ends when it has turned far enough to either side, so a short backward arc ends "
        "immediately if the robot still rolls forward; the speed keeps the last direction, and the length of the last "
        "`fwd` displaces the straight piece",
        "arcs have a sign, the speed is restored, and the straight piece is where it was planned",
    )
    topoint_evaluates: bool = _fixed(
        "`setpar` of `evalmethod` has no effect (a double is written over an int)",
        "with 1, `drivetopoint` takes the shortest path that does not go backward",
    )
    white_edges: bool = _fixed(
        '`followline` with "wl" or "wr" drives straight on: the edges of a white line are not computed',
        "the edges of a white line are computed in the same way as those of a black line",
    )
    stands_at_first: bool = _fixed(
        'before its first motion the robot holds its heading, so that `set "$odoth"` makes it turn',
        "the robot does not move",
    )
    counts_ticks: bool = _fixed(
        "each answer of the robot counts as one period: after a stall of n ticks, MRC computes n times the speed; "
        "beyond `maxtick`, it assumes a fault and loses the distance and the turn",
        "the robot's `tick` gives the number of periods",
    )
    velomega_steers: bool = _fixed(
        "`turnc`, `followline`, `followwall`, `motorcmds` and `align` set wheel speeds; a velocity-omega robot "
        "takes the left one as its speed and keeps its turn rate",
        "the speed and the turn rate are computed from both wheels",
    )
    outputs_round_alike: bool = _fixed(
        "`setoutput` sends trunc(v + 0.5), so that -3 is sent as -2; wheel speeds are floor(v + 0.5), and speeds of a "
        "velocity-omega robot are truncated",
        "all are rounded to the nearest integer, halves away from zero",
    )
    reads_uncalibrated: bool = _fixed(
        "line sensors without a calibration read 0: black everywhere", "they read their raw value divided by 255"
    )
    sees_without_ir: bool = _fixed(
        "an SMR without infrared sensors has an obstacle at 0 m and never moves",
        "a robot without such sensors has no obstacles",
    )

    # -- the language
    rem_excludes_divisor: bool = _fixed("`rem(3, 3)` is 3", "`rem(3, 3)` is 0")
    file_lines: bool = _fixed(
        "the line number in an error counts the lines executed so far, including passes of a loop",
        "it is the line of the file",
    )
    checks_first: bool = _fixed(
        "an error in a script is found when its line is reached",
        "a script with errors does not start; all errors are reported, with line and column",
    )
    says_why: bool = _fixed(
        "an error reads `syntax error in line : 3`; motions print their plans",
        "an error describes the fault and the expected text; motions print nothing",
    )
    ascii_only: bool = _fixed(
        "a character beyond ASCII ends its line, and MRC forgets an error before it",
        "it is an error, except in texts and comments",
    )
    new_variables_read_on: bool = _fixed(
        "after the first assignment to a new variable, the rest of the line is ignored; if it begins with another "
        "new name, that variable is made instead",
        "the rest of the line is executed",
    )
    indices_are_checked: bool = _fixed(
        "an assignment beyond an array is ignored; a value read there is a tiny number that counts as true; `set` "
        "and `log` reach other variables",
        "the mission fails, and the error names the index",
    )
    names_are_checked: bool = _fixed(
        "unknown names are ignored in `set`, `setoutput`, `setgain`, `setoffset`, `control`, `log` and `stream`; "
        "`setpar`, `routeinput` and `routeoutput` print a complaint",
        "the mission fails, and the error gives the name",
    )
    needs_are_checked: bool = _fixed(
        "`vision`, `laser` and `get` without a server, `play`, `speak` and other special hardware print a line or "
        "nothing, and the script continues",
        "the mission fails unless you pass a function for them",
    )
    numbers_are_checked: bool = _fixed(
        "a motion accepts a nan, an infinite length, and an acceleration that is not positive; a setting accepts any "
        'number, and after `set "odowidth" 0` the heading is not a number any more',
        "the mission fails, and the error gives the value",
    )
    knows_tick: bool = _fixed("`$tick` is 0", "`$tick` is the robot's tick count")
    knows_time: bool = _fixed(
        "`$time` is 0 on a robot whose time stands still between two exchanges (MRC's option `-s`)",
        "`$time` is the elapsed time of the robot, in s",
    )
    watches_apart: bool = _fixed(
        "there are two watches, and further ones are ignored; a watch overwrites the data of `$condition`",
        "there are up to 100 watches, and they do not affect `$condition`",
    )

    # -- the server
    reads_input: bool = _fixed(
        "`read` waits for its conditions: no line from a client ends it",
        "it ends with the next line from its client that is not an immediate command; the line becomes the text `$str`",
    )
    client_loss_stops: bool = _fixed(
        "when a client disconnects, its commands keep running", "they are flushed, and the robot stops"
    )
    flush_stops: bool = _fixed(
        "after `flushcmds`, the robot continues to the end of its motion, which might never come", "the robot stops"
    )


@dataclass(frozen=True)
class Difference:
    """Row of the table of differences.

    Attributes:
        name: Name of the field of `Profile`.
        mrc: Behaviour of the original.
        sound: Behaviour of the sound profile.
    """

    name: str
    mrc: str
    sound: str


def differences() -> tuple[Difference, ...]:
    """Return every difference between the two profiles."""
    return tuple(
        Difference(each.name, each.metadata["mrc"], each.metadata["sound"])
        for each in fields(Profile)
        if "mrc" in each.metadata
    )


#: Behaviour of MRC that neither profile imitates, and the behaviour of this library instead.
BOTH: tuple[tuple[str, str], ...] = (
    (
        "a loop that takes no time never returns, and the robot continues to drive",
        "the mission fails after 20000 lines",
    ),
    ("more than 1000 nested calls, 10000 values or 49 parameters overrun memory", "the mission fails"),
    ("a text instead of a number, or a number instead of a text, is read as its bytes", "the line fails"),
    ("a speed that is not a number is sent as -2147483648", "0 is sent; numbers that are too large are limited"),
    ("`rem` and the angles of huge numbers take forever", "they are reduced in one step"),
    ("`eval .` hangs, a name of more than 79 letters overruns memory", "the line fails"),
    (
        "a single `goto` from a client jumps into the plan that ran last, and MRC hangs after the end of the plan",
        "it has no labels to jump to, and fails",
    ),
    ("`stream 0` without xml ends MRC (division by zero)", "the values are sent once"),
    (
        "`followwall2` below 0.0052 m/s reads its gains from the memory before its table",
        "it takes the gains of the first row",
    ),
    (
        "if MRC is killed, the robot keeps its last speeds",
        "the robot's own rule applies; a turtle stops without its master",
    ),
)


SOUND = Profile()
MRC = Profile("mrc", **{each.name: False for each in differences()})
PROFILES = {profile.name: profile for profile in (MRC, SOUND)}


def find_profile(profile: Profile | str) -> Profile:
    """Return the profile with a name. A `Profile` is returned unchanged.

    Raises:
        BadValue: If no profile has this name.
    """
    if isinstance(profile, Profile):
        return profile
    if not isinstance(profile, str) or profile not in PROFILES:
        raise BadValue(f"compat={profile!r}; expected 'sound', 'mrc' or a Profile")
    return PROFILES[profile]
