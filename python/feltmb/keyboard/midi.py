"""MIDI files in and out: a file plays the action, and what it strikes becomes a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.keyboard.gestures import DEPTH, UP_SPEED, Inversion, Press, gesture, run_all, truth_of
from feltmb.keyboard.velocity import VelocityCurve
from feltmb.mechanism import Action
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import read_input, write_file

if TYPE_CHECKING:
    from feltmb.run.results import Run

LARGEST = 20_000_000  # bytes of a MIDI file
TICKS = 1000  # ticks a quarter note of a written file, 0.5 s long: 0.5 ms a tick
#: Notes of one key are one gesture if the finger has less time than this in between [s].
TOGETHER = 0.5
LEAST_HOLD = 0.005  # s
#: Touch of the finger: pressed. A soft key that is struck by a finger of constant speed bounces.
POWER = 2.0
#: Twice a correction of the finger speed from the hammer speed that it made.
CORRECTIONS = 2


@dataclass(frozen=True)
class MidiNote:
    """One note: MIDI number, start and end [s], velocity."""

    number: int
    start: float
    end: float
    velocity: int


@dataclass(frozen=True)
class Played:
    """A note of a file and what it struck.

    Attributes
    ----------
    note : MidiNote
        As in the file.
    speed : float
        Hammer speed at the string [m/s]; NaN: the hammer did not reach it.
    time : float
        Time of the strike [s].
    velocity : int
        Velocity of this speed; 0: no strike.
    bounces : int
        Further strikes of the same press.
    """

    note: MidiNote
    speed: float
    time: float
    velocity: int
    bounces: int


def _mido() -> Any:
    try:
        import mido
    except ImportError:
        raise InvalidParameter("MIDI files need mido; install the extra: feltmb[midi]") from None
    return mido


@checked
def read_midi(path: str | Path) -> list[MidiNote]:
    """Notes of a MIDI file in the order of their starts; drums (channel 10) are left out.

    Raises
    ------
    InvalidParameter
        The file is no MIDI file, or has no note.
    """
    import io

    mido = _mido()
    path = Path(path)
    data = read_input(path, most=LARGEST)
    try:
        messages = list(mido.MidiFile(file=io.BytesIO(data)))
    except (OSError, EOFError, ValueError, KeyError, IndexError) as fault:
        raise InvalidParameter(
            f"{path}: is no MIDI file ({fault or type(fault).__name__})"
        ) from None
    now = 0.0
    open_notes: dict[tuple[int, int], tuple[float, int]] = {}
    notes = []

    def close(which: tuple[int, int]) -> None:
        if which in open_notes:
            start, velocity = open_notes.pop(which)
            notes.append(MidiNote(which[1], start, max(now, start + LEAST_HOLD), velocity))

    for message in messages:
        now += message.time
        if message.type not in ("note_on", "note_off") or message.channel == 9:
            continue
        which = (message.channel, message.note)
        close(which)
        if message.type == "note_on" and message.velocity:
            open_notes[which] = (now, message.velocity)
    for which in list(open_notes):
        close(which)
    if not notes:
        raise InvalidParameter(f"{path}: has no note")
    return sorted(notes, key=lambda n: (n.start, n.number))


@checked
def write_midi(path: str | Path, notes: Sequence[MidiNote], *, force: bool = False) -> Path:
    """Write notes as a MIDI file of one track.

    Parameters
    ----------
    path
        File to be written.
    notes
        Notes.
    force
        False: an existing file is not overwritten.
    """
    mido = _mido()
    events: list[tuple[float, int, int, int]] = []
    for n in notes:
        events += [(n.start, 1, n.number, n.velocity), (n.end, 0, n.number, 0)]
    track, last = mido.MidiTrack(), 0
    for time, on, number, velocity in sorted(events):
        tick = round(time * 2 * TICKS)
        kind = "note_on" if on else "note_off"
        track.append(mido.Message(kind, note=number, velocity=velocity, time=tick - last))
        last = tick
    made = mido.MidiFile(ticks_per_beat=TICKS)
    made.tracks.append(track)
    return write_file(Path(path), lambda p: made.save(str(p)), force=force)


@checked
def play(
    action: Action,
    notes: Sequence[MidiNote],
    curve: VelocityCurve | None = None,
    *,
    jobs: int | None = None,
) -> list[Played]:
    """Play notes on an action: each velocity by the finger speed that makes its hammer speed.

    The finger presses with a constant acceleration; its speed is found by inversion and then
    corrected from the hammer speed that it made. All notes are played on this one action. Notes
    of one key that follow each other within half a second are one motion of the finger.

    Parameters
    ----------
    action
        Action that is played.
    notes
        Notes, sorted by their starts.
    curve
        Velocities of hammer speeds; default: 52 + 25 log2(v).
    jobs
        Threads.
    """
    curve = curve or VelocityCurve()
    inversion = Inversion(action)
    low, high = inversion.limits(POWER)
    groups: list[list[int]] = []
    last: dict[int, list[int]] = {}
    for i, note in enumerate(notes):
        group = last.get(note.number)
        if group is None or note.start - notes[group[-1]].end > TOGETHER:
            group = last[note.number] = []
            groups.append(group)
        group.append(i)
    wanted = [min(max(curve.speed(n.velocity), low), high) for n in notes]
    # What the finger aims at: hammer speeds, and how much earlier than the note it is down.
    aimed, ahead = list(wanted), [0.0] * len(notes)
    struck: list[tuple[float, float, int]] = []
    for _ in range(1 + CORRECTIONS):
        plans = [_plan(notes, group, inversion, aimed, ahead) for group in groups]
        struck = [(math.nan, math.nan, 0)] * len(notes)

        def take(
            index: int, run: Run, plans: list[Any] = plans, struck: list[Any] = struck
        ) -> None:
            _, shift, starts = plans[index]
            hits = truth_of(run)
            for i, start, end in zip(groups[index], starts, [*starts[1:], math.inf], strict=True):
                own = [(t, v) for t, v in hits if start <= t < end]
                if own:
                    struck[i] = (own[0][0] + shift, own[0][1], len(own) - 1)

        run_all(action, (gesture(presses, "midi") for presses, _, _ in plans), take, jobs)
        for i, (t, v, _) in enumerate(struck):
            if not math.isnan(v):
                more = wanted[i] / v
                aimed[i] = min(max(aimed[i] * min(max(more, 0.7), 1.4), low), high)
                ahead[i] += t - notes[i].start
    return [
        Played(n, v, t, 0 if math.isnan(v) else curve.velocity(v), more)
        for n, (t, v, more) in zip(notes, struck, strict=True)
    ]


def _plan(
    notes: Sequence[MidiNote],
    group: Sequence[int],
    inversion: Inversion,
    aimed: Sequence[float],
    ahead: Sequence[float],
) -> tuple[list[Press], float, list[float]]:
    """Presses of a group, the time of the file at the start of its run, starts of the presses."""
    fingers = [inversion.finger_speed(aimed[i], POWER) for i in group]
    begins = [
        notes[i].start - POWER * DEPTH / f - ahead[i] for i, f in zip(group, fingers, strict=True)
    ]
    shift = begins[0] - 0.02
    presses, starts, free = [], [], 0.0
    for k, (i, finger) in enumerate(zip(group, fingers, strict=True)):
        start = max(begins[k] - shift, free)
        bottom = start + POWER * DEPTH / finger
        up = UP_SPEED
        hold = max(notes[i].end - shift - bottom, LEAST_HOLD)
        if k + 1 < len(group):  # be back in time, faster if there is little of it
            room = max(begins[k + 1] - shift - bottom, 0.03)
            hold = min(hold, 0.5 * room)
            up = max(up, DEPTH / (room - hold))
        presses.append(Press(finger, POWER, hold, 1.0, up, start))
        starts.append(start)
        free = bottom + hold + DEPTH / up + 0.002
    return presses, shift, starts
