"""``feltmb keyboard``: weights of 88 keys, and ground truth for sensors of keyboards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.completing import actions, packaged
from unmodeled.cli.options import (
    FORCE,
    SEED,
    FileName,
    Number,
    Quantity,
    argument,
    count,
    declare,
    fields_of,
    option,
    pairs,
    parse_option,
    picture,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    complain,
    console,
    print_json,
    save_figure,
    save_text,
    say,
    say_written,
    show,
    working,
)

if TYPE_CHECKING:
    import pandas as pd

    from feltmb.keyboard import Balance, Keyboard, VelocityCurve


class _Keyboard(click.Group):
    """Group whose command ``weights`` need not be named: ``feltmb keyboard FILE``."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        named = args[0] in self.commands or args[0].startswith("-")
        return super().resolve_command(ctx, args if named else ["weights", *args])


@click.group(cls=_Keyboard, context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Weights of the keys of a keyboard, and ground truth for its sensors.

    feltmb keyboard FILE is short for feltmb keyboard weights FILE.
    """


def _points(option: str, texts: tuple[str, ...]) -> Any:
    """A wanted curve [g]: a number, the name of a level, or numbers by key; None: not given."""
    if not texts:
        return None
    if len(texts) == 1 and "=" not in texts[0]:
        level = option != "--target" and texts[0].isdigit()
        return texts[0] if level else 1e3 * parse_option(option, texts[0], "kg")
    return {
        round(parse_option(option, key, "1")): 1e3 * parse_option(option, value, "kg")
        for key, value in pairs(option, texts, "KEY=WEIGHT").items()
    }


@dataclass(frozen=True)
class Measured:
    """What keys have that was not measured."""

    key_ratio: float | None = option(
        "Key ratio of keys without a measured one; default: 0.5.", Number(0.3, 0.8)
    )
    whippen: float | None = option(
        "Whippen radius weight of keys without a measured one [kg], such as 19.5g; default: "
        "18.5 g.",
        Quantity("kg", 0.005, 0.04),
        words="--whippen",
    )

    def balance(self, keyboard: Path | Keyboard) -> Balance:
        """The analyzed weights of a file, or of a keyboard."""
        from feltmb.keyboard import analyze, read_keyboard

        keyboard = read_keyboard(keyboard) if isinstance(keyboard, Path) else keyboard
        weight = None if self.whippen is None else 1e3 * self.whippen
        return analyze(keyboard, key_ratio=self.key_ratio, whippen_weight=weight)


@dataclass(frozen=True)
class Wanted:
    """What the work is to reach, and the leads at hand."""

    target: tuple[str, ...] = option(
        "Wanted balance as played, such as 38g, or points of a curve, such as 1=42g,88=36g; "
        "default: the smooth curve.",
        words="--target",
        metavar="CURVE",
    )
    hammers: tuple[str, ...] = option(
        "Wanted strike weight: a level of D. Stanwood, 1 to 13, a weight, or points such as "
        "1=11g,88=5g; default: the smooth curve.",
        words="--hammers",
        metavar="CURVE",
    )
    fronts: tuple[str, ...] = option(
        "Wanted front weight in place of a balance: a level of D. Stanwood, 5 to 9, a weight, or "
        "points.",
        words="--fronts",
        metavar="CURVE",
    )
    leads: tuple[str, ...] = option(
        "Masses of the leads at hand, such as 8g,14g; their places are told. Default: lead of any "
        "mass at --lead-at.",
        words="--leads",
        metavar="MASS",
    )
    lead_at: float = option("Distance of added lead from the balance pin [m].", positive("m"), 0.14)

    def work(self, balance: Balance) -> pd.DataFrame:
        """The list of work."""
        from feltmb.keyboard import list_of_work

        return list_of_work(
            balance,
            target=_points("--target", self.target),
            hammers=_points("--hammers", self.hammers),
            fronts=_points("--fronts", self.fronts),
            leads=[1e3 * parse_option("--leads", text, "kg") for text in self.leads],
            lead_at=self.lead_at,
        )


MEASURED = fields_of("feltmb.cli.keyboard:Measured")
WANTED = fields_of("feltmb.cli.keyboard:Wanted")
BASE = option(
    "Action whose lengths and felts are used.",
    default="grand_action",
    words="--base",
    metavar="ACTION",
    complete=actions,
)
#: Order of the work.
PARTS = ("friction", "hammer", "spring", "lead")


@declare("weights", command, "Balance, outliers, list of work of a keyboard.")
def weights(
    file: Path = argument(),
    measured: Measured = MEASURED,
    wanted: Wanted = WANTED,
    order: str = option(
        "Order of the list: by key, or by work.", click.Choice(["key", "work"]), "key", words="--by"
    ),
    strip: Path | None = option(
        "Draw a strip of all keys at true size, with the leads of the list at their places.",
        FileName(".pdf", ".svg", ".png"),
        metavar="FILE",
    ),
    image: Path | None = picture("Draw all weights over the keys."),
    out: Path | None = option(
        "Write the page (.html), all numbers (.csv), or the weights for Piano Touch Lab (.json).",
        FileName(".html", ".csv", ".json"),
        metavar="FILE",
    ),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Balance, friction and strike weight ratio of each key of FILE, and the list of work.

    FILE is a CSV file with one row a key (key, down weight, up weight, front weight, strike weight,
    and optionally down weight with support spring, key ratio), or JSON of Piano Touch Lab.
    """
    from feltmb.keyboard.report import draw, html_page, key_table, sentences
    from feltmb.keyboard.strip import draw_strip

    check_targets(out, pictures=(image, strip), force=force)
    balance = measured.balance(file)
    work = wanted.work(balance)
    if order == "work":
        work = work.sort_values("part", key=lambda p: p.map(PARTS.index), kind="stable")
    if as_json:
        outliers = [vars(o) for o in balance.outliers]
        print_json(
            {
                "summary": balance.summary(),
                "notes": list(balance.notes),
                "outliers": outliers,
                "work": work.astype(object).where(work.notna(), None).to_dict("records"),
            }
        )
    else:
        screen = console()
        for text in (*sentences(balance), *(f"Note: {n}." for n in balance.notes)):
            screen.print(text)
        if balance.outliers:
            show(
                "keys that stand out",
                ">key | note | what | >measured | >curve | unit | reason",
                [
                    (str(o.key), balance.frame.at[o.key, "note"], o.what, f"{o.value:.1f}",
                     f"{o.curve:.1f}", o.unit, o.reason)
                    for o in balance.outliers
                ],
            )  # fmt: skip
        show(
            "list of work",
            ">key | note | part | work",
            [(str(r.key), r.note, r.part, r.work) for r in work.itertuples()],
        )
    if out is not None and out.suffix.lower() == ".json":
        say_written(balance.keyboard.write(out, force=force))
    elif out is not None and out.suffix.lower() == ".csv":
        save_text(out, key_table(balance).to_csv(float_format="%.4g"), force=force)
    else:
        save_text(out, lambda: html_page(balance, work), force=force)
    save_figure(image, lambda: draw(balance), force=force)
    save_figure(strip, lambda: draw_strip(balance, work), force=force)


@declare("touch", command, "How ten keys feel after the work.")
def touch(
    file: Path = argument(),
    keys: tuple[str, ...] = option(
        "Keys, such as 4,40; default: ten of them.", words="--keys", metavar="KEY"
    ),
    base: str = BASE,
    measured: Measured = MEASURED,
    wanted: Wanted = WANTED,
    out: Path | None = option("Write the table.", FileName(".csv"), metavar="FILE"),
    force: bool = FORCE,
) -> None:
    """How keys of FILE feel after the work of the list: simulated slow press, and a press of 5 N.

    The weights are those after the work; lengths, felts and screws are those of a packaged action.
    """
    from feltmb.keyboard import after_work, touch_of_keys
    from feltmb.keyboard.note import TEN_KEYS

    check_targets(out, force=force)
    now = measured.balance(file)
    then = measured.balance(after_work(now, wanted.work(now)))
    chosen = [round(parse_option("--keys", key, "1")) for key in keys] or [
        k for k in TEN_KEYS if k <= len(now.frame)
    ]
    with working("simulating") as progress:
        felt = touch_of_keys(then, chosen, base, progress=progress)
    rows = now.frame.loc[felt.index]
    felt.insert(1, "up_now", rows["played"] - rows["friction"])
    felt.insert(1, "down_now", rows["played"] + rows["friction"])
    show(
        f"touch after the work, {now.keyboard.name} on {base}",
        ">key | note | >down now | >down gf | >up now | >up gf | >let-off gf | >hammer m/s at 5 N",
        [
            (str(r.Index), r.note, *(f"{v:.1f}" for v in (r.down_now, r.down_weight, r.up_now,
             r.up_weight, r.let_off_force)), f"{r.hammer_speed:.2f}")
            for r in felt.itertuples()
        ],
        "now: measured; the others: simulated, with the weights after the work",
    )  # fmt: skip
    heads = {c: f"{c} [{'m/s' if c == 'hammer_speed' else 'gf'}]" for c in felt if c != "note"}
    save_text(out, lambda: felt.rename(columns=heads).to_csv(float_format="%.5g"), force=force)


@declare("action", command, "Set up the action of one key.")
def action(
    file: Path = argument(),
    key: int = argument(count(1, 108)),
    base: str = BASE,
    measured: Measured = MEASURED,
    out: Path | None = option("Mechanism file to be written.", FileName(".toml")),
    force: bool = FORCE,
) -> None:
    """Set up the action of the key KEY of FILE, for touch and strokes.

    Strike weight, strike weight ratio, balance as played and friction are those of the key.
    Lengths, felts and screws are those of a packaged action, which is regulated again.
    """
    from feltmb.keyboard import action_of_key

    check_targets(out, force=force)
    balance = measured.balance(file)
    with working("measuring") as progress:
        made = action_of_key(balance, key, base, progress=progress)
    show(
        f"action of key {key}, {balance.frame.at[key, 'note']}",
        "| >keyboard | >action",
        [(name, f"{v:.2f}", f"{made.reached[name]:.2f}") for name, v in made.wanted.items()],
        "; ".join(("weights in g", *made.notes)),
    )
    save_text(out, made.to_toml, force=force)


# --- ground truth for sensors --------------------------------------------------------------------

ACTION = argument(complete=actions, default="grand_action")
SENSOR = option(
    "Packaged sensor or TOML file.",
    default="reflective",
    metavar="FILE",
    complete=packaged("sensors"),
)
CURVE = option(
    "Velocity curve: points SPEED=VELOCITY, such as 0.3m/s=1,7m/s=127, or a CSV file of measured "
    "pairs with the columns speed [m/s] and velocity; default: 52 + 25 log2(v), v in m/s.",
    words="--curve",
    metavar="SPEED=VELOCITY",
)


def _curve(points: tuple[str, ...]) -> VelocityCurve:
    from feltmb.keyboard import VelocityCurve
    from feltmb.keyboard.velocity import read_curve

    if not points:
        return VelocityCurve()
    if len(points) == 1 and "=" not in points[0]:
        return read_curve(points[0])
    found = sorted(
        (parse_option("--curve", speed, "m/s"), parse_option("--curve", velocity, "1"))
        for speed, velocity in pairs("--curve", points, "SPEED=VELOCITY").items()
    )
    return VelocityCurve([v for v, _ in found], [n for _, n in found])


@declare("sensor", command, "What a sensor reads in a stroke.")
def sensor_command(
    action: str = ACTION,
    sensor: str = SENSOR,
    stroke: str | None = option(
        "Packaged stroke, TOML or CSV file; default: a press to --speed.", metavar="FILE"
    ),
    speed: float = option(
        "Speed of the pressing finger at the key bottom [m/s].", positive("m/s"), 0.3
    ),
    seed: int = SEED,
    points: tuple[str, ...] = CURVE,
    image: Path | None = picture("Draw the samples with the strikes, and the curve."),
    out: Path | None = option("Write the samples (CSV).", FileName(".csv"), metavar="FILE"),
    force: bool = FORCE,
) -> None:
    """What a sensor at hammer, key or both reads in a stroke of ACTION, and the true strikes."""
    from feltmb.keyboard import load_sensor, sensed
    from feltmb.keyboard.gestures import Press, gesture
    from feltmb.mechanism import load_action
    from feltmb.run.stroke import load_stroke

    check_targets(out, pictures=(image,), force=force)
    described, curve = load_sensor(sensor), _curve(points)
    played = gesture([Press(speed, 2.0)], "press") if stroke is None else load_stroke(stroke)
    setup, record = sensed(load_action(action), played, described, seed=seed)
    for note in described.notes:
        complain(f"note: {note}")
    show(
        f"strikes, {setup.action}, {described.name}: {len(record.samples)} samples",
        ">time ms | >speed at the string m/s | >MIDI velocity",
        [(f"{1e3 * t:.2f}", f"{v:.3f}", str(curve.velocity(v))) for t, v in record.truth],
    )
    if any(not curve.speeds[0] <= v <= curve.speeds[-1] for _, v in record.truth):
        complain(f"note: {curve.ends}")
    save_text(out, lambda: record.samples.to_csv(float_format="%.7g"), force=force)
    save_figure(image, lambda: record.plot(setup), force=force)


KINDS = option(
    "Kinds of strokes, such as repeated,aftertouch; default: struck, pressed, staccato, repeated, "
    "half return in usual shares.",
    words="--kinds",
    metavar="KIND",
)


@declare("stream", command, "Print labeled records for firmware.")
def stream(
    action: str = ACTION,
    sensor: str = option("Packaged sensor or TOML file.", default="linear", metavar="FILE"),
    records: int = option("Number of records.", count(1, 1_000_000), 10, words="--count"),
    kinds: tuple[str, ...] = KINDS,
    seed: int = SEED,
) -> None:
    """Print what a sensor reads, a line of counts a sample, and after each record the truth.

    A record begins with lines of comments: rate and start of the samples, converter, distances of
    the action and curve of the sensor. feltmb keyboard score stream:COMMAND gives a program the
    same lines, without the truth, and scores what it prints.
    """
    from feltmb.keyboard import labeled_strokes

    setup, made = labeled_strokes(action, sensor, records, kinds=kinds, seed=seed)
    for record in made:
        say(setup.stream(record.samples), nl=False)
        say("# truth: time,speed")
        for time, speed in record.truth:
            say(f"# {time:.6f},{speed:.4f}")


@declare("strokes", command, "Write labeled records (Parquet, JSON lines).")
def strokes(
    action: str = ACTION,
    sensor: str = SENSOR,
    records: int = option("Number of records.", count(1, 1_000_000), 1000, words="--count"),
    kinds: tuple[str, ...] = KINDS,
    seed: int = SEED,
    jobs: int | None = option("Threads; default: one a core.", count()),
    points: tuple[str, ...] = CURVE,
    out: Path = option(
        "File to be written: .parquet (extra feltmb[parquet]), or .jsonl, lines of JSON.",
        FileName(".parquet", ".jsonl"),
        metavar="FILE",
        required=True,
    ),
    force: bool = FORCE,
) -> None:
    """Write labeled records: random strokes of ACTION, what the sensor reads, and the truth.

    The strokes are struck, pressed, staccato, repeated and repeated from half returns, from ppp to
    fff. The same seed makes the same records.
    """
    from feltmb.keyboard import labeled_strokes, write_set

    check_targets(out, force=force)
    curve = _curve(points)
    with working("simulating"):
        setup, made = labeled_strokes(action, sensor, records, kinds=kinds, seed=seed, jobs=jobs)
        write_set(out, setup, made, curve=curve, force=force)
    for note in setup.sensor.notes:
        complain(f"note: {note}")
    say_written(out)


@declare("score", command, "Score an algorithm against the truth.")
def score_of(
    algorithm: str = argument(),
    given: Path | None = option(
        "Labeled records of feltmb keyboard strokes; default: simulate --count of them.",
        words="--set",
        metavar="FILE",
    ),
    action: str = option("Action that is played.", default="grand_action", complete=actions),
    sensor: str = SENSOR,
    records: int = option("Number of records.", count(1, 1_000_000), 1000, words="--count"),
    kinds: tuple[str, ...] = KINDS,
    seed: int = SEED,
    image: Path | None = picture("Draw the errors of speed and time over the speed."),
    out: Path | None = option("Write all strikes (CSV).", FileName(".csv"), metavar="FILE"),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Compare the strikes that ALGORITHM finds with the true ones, by level from ppp to fff.

    ALGORITHM is largest_derivative, model_based, a Python function (FILE.py:FUNCTION) of the
    samples and the setup, or a program that is called with a CSV file of samples and a JSON file of
    the setup and prints CSV with the columns time,speed. stream:COMMAND is a program that reads the
    lines of feltmb keyboard stream, without the truth, from its input, and prints the same.
    """
    from feltmb.keyboard import labeled_strokes, load_algorithm, read_set, score

    check_targets(out, pictures=(image,), force=force)
    name, function = load_algorithm(algorithm)
    with working("simulating"):
        if given is None:
            setup, made = labeled_strokes(action, sensor, records, kinds=kinds, seed=seed)
        else:
            setup, made = read_set(given)
        result = score(function, made, setup, name=name)
    for note in (*setup.sensor.notes, *result.failures[:3]):
        complain(f"note: {note}")
    if len(result.failures) > 3:
        complain(
            f"note: the algorithm failed in {len(result.failures)} of {result.records} records"
        )
    if as_json:
        rows = result.table.astype(object).where(result.table.notna(), None)
        print_json({"levels": rows.to_dict("index"), "failures": list(result.failures)})
    else:
        show(
            f"{name}: {setup.sensor.name} in {setup.action}, {result.records} records",
            "level | >strikes | >missed | >false | >speed rms % | >mean % | >least % | >most % | "
            ">time rms ms",
            [
                (level, *(str(int(v)) for v in row[:3]), *(f"{v:.1f}" for v in row[3:7]),
                 f"{row[7]:.2f}")
                for level, row in zip(result.table.index, result.table.to_numpy(), strict=True)
            ],
            "errors of the strikes that were found; strikes below 0.2 m/s do not count",
        )  # fmt: skip
    save_text(out, lambda: result.strikes.to_csv(index=False, float_format="%.6g"), force=force)
    save_figure(image, result.plot, force=force)


@declare("play", command, "Play a MIDI file on an action.")
def play_file(
    file: Path = argument(),
    action: str = ACTION,
    points: tuple[str, ...] = CURVE,
    out: Path | None = option("MIDI file of what was struck.", FileName(".mid", ".midi")),
    force: bool = FORCE,
) -> None:
    """Play the MIDI file FILE on ACTION, and tell what the hammer struck.

    The speed of the finger for a velocity is found by inversion of simulated strokes. All notes are
    played on this one action.
    """
    from feltmb.keyboard import play, read_midi, write_midi
    from feltmb.keyboard.midi import MidiNote
    from feltmb.mechanism import load_action

    check_targets(out, force=force)
    notes, curve = read_midi(file), _curve(points)
    with working("playing"):
        played = play(load_action(action), notes, curve)
    struck = [p for p in played if p.velocity]
    off = [abs(p.velocity - p.note.velocity) for p in struck]
    late = [1e3 * abs(p.time - p.note.start) for p in struck]
    show(
        f"{file.name} on {action}",
        "| >",
        [
            ("notes", str(len(notes))),
            ("without a strike", str(len(notes) - len(struck))),
            ("with further strikes", str(sum(p.bounces > 0 for p in played))),
            ("largest error of the velocity", str(max(off, default=0))),
            ("largest error of the time", f"{max(late, default=0.0):.1f} ms"),
        ],
    )
    if out is not None:
        again = [
            MidiNote(p.note.number, p.time, max(p.note.end, p.time + 0.005), p.velocity)
            for p in struck
        ]
        say_written(write_midi(out, again, force=force))
