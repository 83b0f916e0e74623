"""Weights of 88 keys: the measured Gaveau, files, bad files, the list of work."""

import json

import numpy as np
import pandas as pd
import pytest
from calls import command, refusal, refused

from feltmb.keyboard import after_work, analyze, list_of_work, note_name, read_keyboard
from feltmb.keyboard.keys import COLUMNS, Keyboard, is_sharp
from feltmb.keyboard.report import draw, html_page
from feltmb.keyboard.strip import draw_strip


@pytest.fixture(scope="module")
def file(data):
    return data / "gaveau" / "keys.csv"


@pytest.fixture(scope="module")
def gaveau(file):
    return analyze(read_keyboard(file), whippen_weight=19.5)


def changed(tmp_path, file, change):
    """The file with a changed frame of its text."""
    frame = pd.read_csv(file, index_col=0)
    made = change(frame)
    path = tmp_path / "k.csv"
    (frame if made is None else made).to_csv(path)
    return path


def test_the_weights_predict_the_balances(gaveau):
    assert gaveau.residual.notna().all()
    assert gaveau.residual.abs().max() < 4.0
    assert gaveau.residual.std() < 1.3


def test_keys_that_were_left_out_are_predicted_nearly_as_well(gaveau):
    """The curve does not only follow its own key: every eighth key is taken from the fit."""
    off = []
    for first in range(8):
        frame = gaveau.keyboard.frame.copy()
        rows = frame.index[first::8]
        frame.loc[rows, ["down_weight", "up_weight"]] = np.nan
        without = analyze(Keyboard("part", frame), whippen_weight=19.5)
        off += list((gaveau.frame["balance"] - without.frame["balance_curve"])[rows])
    assert np.std(off) < 1.43
    assert np.mean(np.abs(off) < 3.0) > 0.9


def test_numbers_of_the_gaveau_are_those_of_its_data_note(gaveau):
    numbers = gaveau.summary()
    for name, mean, std in (
        ("friction", 10.3, 2.2), ("balance", 58.5, 7.3), ("ratio", 6.24, 0.28),
        ("spring", 15.0, 2.1),
    ):  # fmt: skip
        assert numbers[name]["mean"] == pytest.approx(mean, abs=0.06)
        assert numbers[name]["std"] == pytest.approx(std, abs=0.08)
    assert numbers["spring"]["count"] == 48
    assert gaveau.frame["spring"].first_valid_index() == 1


def test_key_4_is_rough_and_no_other_key_is(gaveau):
    rough = [o for o in gaveau.outliers if o.what == "friction"]
    assert [o.key for o in rough] == [4]
    assert rough[0].value == 18.0
    assert all(o.reason for o in gaveau.outliers)
    others = [o for o in gaveau.outliers if o.what != "friction"]
    assert [(o.key, o.what) for o in others] == [(41, "uneven friction")]


def test_sharps_have_a_longer_lever(gaveau):
    """Without their own factor, sharps and naturals lie apart."""
    assert 1.03 < gaveau.sharp_factor < 1.09
    ratio, sharp = gaveau.frame["ratio"], gaveau.frame["sharp"]
    assert ratio[sharp].mean() - ratio[~sharp].mean() > 0.3
    assert abs(gaveau.residual[sharp].mean() - gaveau.residual[~sharp].mean()) < 0.3


def test_planted_faults_are_told(gaveau):
    frame = gaveau.keyboard.frame.copy()
    frame.loc[60, ["down_weight", "up_weight"]] += [9.0, -9.0]  # friction
    frame.loc[30, ["down_weight", "up_weight"]] += 12.0  # a lead fell out: front weight as before
    frame.loc[70, "strike_weight"] += 1.5
    told = {(o.key, o.what) for o in analyze(Keyboard("k", frame), whippen_weight=19.5).outliers}
    assert {(60, "friction"), (30, "balance"), (70, "strike weight"), (4, "friction")} <= told


def made_up(seed, fault):
    """A keyboard of one ratio, 5.9, whose leads scatter by 0.8 g; weighed to 1 g."""
    rng = np.random.default_rng(seed)
    keys = np.arange(1, 89)
    x = (keys - 1) / 87
    lever = np.where([is_sharp(k) for k in keys], 1.05, 1.0)
    strike, friction = 12.0 - 6.0 * x**1.1, 16.0 - 8.0 * np.sin(1.4 * x)
    front = (9.25 + 5.9 * strike) * lever - 38.0 + rng.normal(0, 0.8, 88)
    strike = strike + rng.normal(0, 0.08, 88)
    frame = pd.DataFrame({"front_weight": front, "strike_weight": strike, "friction": friction},
                         index=pd.RangeIndex(1, 89, name="key"))  # fmt: skip
    frame["friction"] += rng.normal(0, 0.7, 88)
    fault(frame)
    balance = (9.25 + 5.9 * frame["strike_weight"]) * lever - frame["front_weight"]
    for name, sign in (("down_weight", 1.0), ("up_weight", -1.0)):
        frame[name] = (balance + sign * frame["friction"] + rng.normal(0, 1.0, 88)).round()
    frame["front_weight"] = (frame["front_weight"] + rng.normal(0, 0.1, 88)).round(1)
    frame["strike_weight"] = (frame["strike_weight"] + rng.normal(0, 0.03, 88)).round(1)
    return Keyboard("made up", frame.reindex(columns=list(COLUMNS)).astype(float))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_ratio_is_drawn_as_nearly_a_line(seed):
    """Generalized cross-validation drew it with 21 to 24 turns."""
    balance = analyze(made_up(seed, lambda _: None))
    ratio = balance.frame["ratio_curve"] / np.where(
        balance.frame["sharp"], balance.sharp_factor, 1.0
    )
    assert ratio.between(5.75, 6.05).all()
    turns = np.count_nonzero(np.diff(np.sign(np.diff(ratio))))
    assert turns <= 3


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_lead_that_is_missing_stands_out_and_one_that_balances_does_not(seed):
    def fault(frame):
        frame.loc[17, "friction"] += 7.0
        frame.loc[46, "strike_weight"] += 1.2
        frame.loc[60, ["strike_weight", "front_weight"]] += [1.2, 1.2 * 5.9]  # balanced by lead
        frame.loc[70, "front_weight"] -= 5.0

    found = analyze(made_up(seed, fault)).outliers
    told = {(o.key, o.what) for o in found}
    planted = {(17, "friction"), (46, "strike weight"), (60, "strike weight"), (70, "front weight")}
    assert planted <= told
    assert len(told - planted) <= 1
    assert "a lead is missing" in next(o.reason for o in found if o.what == "front weight")


@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        ({"target": 45.0}, "played", 45.0),
        ({"target": {1: 52.0, 88: 40.0}}, "played", np.linspace(52.0, 40.0, 88)),
        ({"hammers": "6"}, "strike_weight", [10.8, 4.9]),
        ({"fronts": {1: 30.0}, "leads": [8.0, 14.0]}, "front_weight", 30.0),
    ],
)
def test_the_list_of_work_makes_the_keyboard_even(gaveau, options, name, value):
    """Done by the balance of weights alone, it leads to the curves."""
    work = list_of_work(gaveau, **options)
    after = analyze(after_work(gaveau, work), whippen_weight=19.5)
    found = (after.frame if name == "played" else after.keyboard.frame)[name].to_numpy()
    if name == "strike_weight":
        found, near = found[[0, -1]], 0.2
    else:
        near = 1.0
    assert np.abs(found - value).max() <= near + 1e-9
    assert list(work[work["part"] == "friction"]["key"]) == [4]
    assert after.frame.at[4, "friction"] == pytest.approx(gaveau.frame.at[4, "friction_curve"])
    if "leads" in options:
        leads = work[work["part"] == "lead"]
        assert set(leads["change"]) <= {8.0, 14.0}
        assert leads["place"].abs().max() <= 0.2


def test_the_strip_has_each_lead_at_its_place_at_true_size(gaveau):
    from matplotlib.patches import Circle

    work = list_of_work(gaveau, target=45.0, leads=[10.0])
    figure = draw_strip(gaveau, work)
    (axes,) = figure.axes
    leads = work[work["part"] == "lead"]
    disks = [p for p in axes.patches if isinstance(p, Circle)]
    assert [d.center[1] for d in disks] == pytest.approx(list(1e3 * leads["place"]))
    low, high = axes.transData.transform([[0.0, 0.0], [100.0, 100.0]]) / figure.dpi * 25.4
    assert np.abs(high - low) == pytest.approx([100.0, 100.0])


def test_names_of_the_keys():
    assert [note_name(k) for k in (1, 4, 40, 49, 88)] == ["A0", "C1", "C4", "A4", "C8"]
    assert sum(map(is_sharp, range(1, 89))) == 36


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("kind", ["json", "csv"])
def test_files_keep_all_weights(gaveau, tmp_path, kind):
    path = gaveau.keyboard.write(tmp_path / f"k.{kind}")
    back = read_keyboard(path)
    pd.testing.assert_frame_equal(back.frame, gaveau.keyboard.frame)
    if kind == "json":
        keys = json.loads(path.read_text())["measures"]["keys"]
        assert len(keys) == 88
        assert keys[0]["downWeightWithSpringSupport"] == 70.0
        assert keys[48]["downWeightWithSpringSupport"] is None


def test_an_export_with_common_ratio_and_whippen_is_read(tmp_path):
    keys = [{"downWeight": 60.0, "upWeight": 35.0, "frontWeight": 5.0, "strikeWeight": 8.0}] * 88
    path = tmp_path / "k.json"
    measures = {"keys": keys, "keyWeightRatio": 0.52, "wippenRadiusWeight": 19.0}
    path.write_text(json.dumps({"data": measures, "piano": {"brand": "A", "model": "B"}}))
    board = read_keyboard(path)
    assert board.name == "A B"
    assert (board.frame["key_ratio"] == 0.52).all()
    assert not any("taken as" in note for note in analyze(board).notes)


def test_decimal_commas_and_ounces(tmp_path, file):
    frame = pd.read_csv(file, index_col=0)
    path = tmp_path / "k.csv"
    heads = ["down with spring [oz]", "down without spring [oz]", "up [oz]", "FW [oz]", "SW [oz]"]
    (frame / 28.349523).to_csv(path, sep=";", decimal=",", header=heads, index_label="key")
    board = read_keyboard(path)
    want = read_keyboard(file).frame
    np.testing.assert_allclose(board.frame.to_numpy(), want.to_numpy(), atol=1e-6)


def rename(old, new):
    return lambda f: f.rename(columns={next(c for c in f if old in c): new})


def put(key, column, value):
    def change(frame):
        name = next(c for c in frame if column in c)
        frame[name] = frame[name].astype(object)
        frame.loc[key, name] = value

    return change


def swap(frame):
    down = next(c for c in frame if "without" in c)
    frame[[down, "up weight [gf]"]] = frame[["up weight [gf]", down]].to_numpy()


def swap_strike(frame):
    pair = ["strike weight [gf]", "front weight [gf]"]
    frame[pair] = frame[pair[::-1]].to_numpy()


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (swap, ["up weight: not below the down weight on 88 keys", "swapped"]),
        (put(7, "up weight", -3), ["key 7: up weight: got -3, expected 0 to 150 g"]),
        (put(9, "strike", "x"), ["line 10: strike_weight: got 'x', expected a number"]),
        (put(9, "up weight", 95), ["key 9: up weight: got 95 g, expected below the down weight"]),
        (lambda f: f / 28.35, ["88 of 88 numbers", "no strike weight", "ounces", "[oz]"]),
        (swap_strike, ["strike weight: 26 of 88 numbers, -8.89 to 1.88", "columns in this order?"]),
        (lambda f: f.iloc[:0], ["got no rows"]),
        (rename("up weight", "up weight [V]"), ["got [V], expected one of g, gf, oz"]),
        (rename("up weight", "U-boat"), ["up weight: got 0 numbers, expected one a key"]),
        (lambda f: f.iloc[:12], ["keys: got 12, expected 20 to 108"]),
        (lambda f: pd.concat([f, f.iloc[4:5]]), ["line 90: key 5: given twice"]),
        (lambda f: f.rename_axis("x"), ["expected a column 'key'"]),
    ],
)
def test_bad_files_are_refused(tmp_path, file, change, parts):
    path = changed(tmp_path, file, change)
    refused(lambda: read_keyboard(path), str(path), *parts)


def test_all_faults_are_told_at_once(tmp_path, file):
    def change(frame):
        put(7, "up weight", -3)(frame)
        put(20, "strike", 90)(frame)

    text = refused(lambda: read_keyboard(changed(tmp_path, file, change)), "2 faults")
    assert "key 7" in text
    assert "key 20" in text


def test_missing_keys_and_other_counts_are_told(tmp_path, file):
    board = read_keyboard(changed(tmp_path, file, lambda f: f.drop(index=[5, 6, 30])))
    assert any("3 keys are missing (5, 6, 30)" in note for note in board.notes)
    balance = analyze(board)
    assert np.isfinite(balance.frame.loc[5, "ratio_curve"])
    board = read_keyboard(changed(tmp_path, file, lambda f: f.iloc[:61]))
    assert any("61 keys, not 88" in note for note in board.notes)
    assert len(board.frame) == 61


def test_an_export_with_faults_is_refused(tmp_path):
    path = tmp_path / "k.json"
    path.write_text('{"measures": {}}')
    refused(lambda: read_keyboard(path), "got no list measures.keys")
    keys = [{"downWeightWithoutSpringSupport": "60", "upWeight": 30}] * 87
    path.write_text(json.dumps({"measures": {"keys": keys}, "piano": {"keyCount": 88}}))
    refused(
        lambda: read_keyboard(path),
        "got 87 keys, expected 88",
        "got '60', expected a number or null",
    )


def test_without_front_and_strike_weights_there_is_balance_and_friction(tmp_path, file):
    path = changed(tmp_path, file, lambda f: f.iloc[:, :3])
    balance = analyze(read_keyboard(path))
    assert balance.frame["friction"].notna().all()
    assert balance.frame["ratio"].isna().all()
    assert any("too few" in note for note in balance.notes)
    assert set(list_of_work(balance)["part"]) == {"friction", "spring", "lead"}


def test_bad_numbers_of_the_call_are_refused(gaveau):
    refused(lambda: list_of_work(gaveau, lead_at=0.4), "lead_at: got 0.4 m")
    refused(lambda: list_of_work(gaveau, target=0.038), "target: got 0.038 g")
    refused(lambda: list_of_work(gaveau, hammers="14"), "hammers: got '14'", "12, 13")
    refused(lambda: list_of_work(gaveau, fronts={99: 8.0}), "fronts: got 8 g at key 99")
    refused(lambda: list_of_work(gaveau, target=40.0, fronts="7"), "lead reaches one of them")
    refused(lambda: list_of_work(gaveau, leads=[0.01]), "leads: got [0.01] g")
    refused(lambda: analyze(gaveau.keyboard, key_ratio=5.0), "key_ratio: got 5")


# ---------------------------------------------------------------- what people see


def test_the_page_holds_everything_and_loads_nothing(gaveau):
    text = html_page(gaveau, list_of_work(gaveau))
    assert "http" not in text
    assert "ease, 4.3 gf less friction" in text
    assert text.count("<tr>") > 88 + 50
    assert "key 4" in text or "<td>4</td>" in text
    assert set(COLUMNS) - {"key_ratio", "whippen_weight", "strike_weight_ratio"} <= {
        part.split(" [")[0] for part in text.replace("<th>", "|").replace("</th>", "|").split("|")
    }


def test_the_picture_has_all_panels(gaveau):
    axes = draw(gaveau).axes
    assert len(axes) == 5
    assert all(ax.get_ylabel() for ax in axes)


def test_command(file, tmp_path):
    out = tmp_path / "page.html"
    done = command("keyboard", file, "--whippen", "19.5g", "-o", out)
    assert done.exit_code == 0
    assert "86 of 88 keys within 3 gf" in done.output
    assert "on 48 keys" in done.output
    assert out.stat().st_size > 100_000
    told = json.loads(command("keyboard", "weights", file, "--json").output)
    assert [o["key"] for o in told["outliers"]] == [4, 41]
    strip = tmp_path / "strip.pdf"
    done = command("keyboard", file, "--target", "1=50g,88=42g", "--hammers", "6", "--by", "work",
                   "--leads", "8g,14g", "--strip", strip)  # fmt: skip
    parts = [w for line in done.output.splitlines() for w in line.split()[2:3]]
    parts = [p for p in parts if p in ("hammer", "lead")]
    assert parts == sorted(parts)
    assert "8.0 g of lead" in done.output
    assert strip.read_bytes().startswith(b"%PDF")
    assert "there is no such file" in refusal("keyboard", "nothing.csv")


# ---------------------------------------------------------------- the action of a key


def test_bad_keys_and_actions_are_refused(gaveau):
    from feltmb.keyboard import action_of_key

    refused(lambda: action_of_key(gaveau, 89), "key: got 89, expected 1 to 88")
    refused(lambda: action_of_key(gaveau, 40, "steinway45_leaded"), "its hammer hangs")


@pytest.mark.slow
def test_the_touch_after_the_work_weighs_what_was_wanted(file, tmp_path):
    out = tmp_path / "t.csv"
    command("keyboard", "touch", file, "--keys", "40", "--target", "45g", "--whippen", "19.5g",
            "-o", out)  # fmt: skip
    row = pd.read_csv(out).iloc[0]
    assert (row["down_weight [gf]"] + row["up_weight [gf]"]) / 2 == pytest.approx(45.0, abs=1.5)
    assert 1.0 < row["hammer_speed [m/s]"] < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("key", [4, 40, 88])
def test_the_action_of_a_key_weighs_what_the_key_weighs(gaveau, key):
    from feltmb.keyboard import action_of_key

    made = action_of_key(gaveau, key)
    for name, near in (("balance", 0.5), ("friction", 0.5), ("strike weight", 0.01)):
        assert made.reached[name] == pytest.approx(made.wanted[name], abs=near)
    assert made.reached["strike weight ratio"] == pytest.approx(
        made.wanted["strike weight ratio"], rel=0.012
    )
    assert made.wanted["friction"] == gaveau.frame.at[key, "friction"]
