"""Write params/felts/a12_NN.toml and params/steinway45_felt.toml: felts of all contacts.

Table A.12 gives force against compression of every contact; the area follows from the pair of
surfaces and a width, the felt from feltmb.felt.fit_contact. Widths and the lengths of felts are
assumed: the thesis tabulates none. A test compares the files with what this script would write.

Usage: python tools/make_contact_felts.py
"""

from __future__ import annotations

from pathlib import Path

import tomlkit

import feltmb
from feltmb import felt
from feltmb.mechanism import Curve

HERE = Path(__file__).resolve().parent.parent / "python" / "feltmb" / "params"

#: contact -> (felt with the fibers and v_f0, area, reason)
CHOICES = {
    "01": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "13 mm", "length": "20 mm"},
           "key tail on a strip of felt"),
    "02": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "13 mm", "length": "22 mm"},
           "key as wide as 13 mm on a punching of 22 mm"),
    "03": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "9 mm"}, "capstan, 9 mm"),
    "04": ("synthetic_leather", {"kind": "circle_on_layer", "width": "8 mm"}, "jack, 8 mm"),
    "05": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "8 mm"}, "jack toe, 8 mm"),
    "06": ("synthetic_hammer", {"kind": "crossed_cylinders"}, "hammer on one string, felt for all"),
    "07": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "6 mm", "length": "20 mm"},
           "shank, 6 mm"),
    "08": ("synthetic_leather", {"kind": "circle_on_layer", "width": "12 mm"}, "butt, 12 mm"),
    "09": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "7 mm"}, "spoon, 7 mm"),
    "10": ("synthetic_moderate_red", {"kind": "circle_on_layer", "width": "3 mm"},
           "three strings, 1 mm each"),
    "11": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "8 mm"}, "jack, 8 mm"),
    "12": ("synthetic_soft_red", {"kind": "circle_on_layer", "width": "8 mm"}, "jack, 8 mm"),
    "13": ("synthetic_leather", {"kind": "circle_on_layer", "width": "12 mm"}, "butt, 12 mm"),
    "14": ("synthetic_leather", {"kind": "circle_on_layer", "width": "12 mm"}, "butt, 12 mm"),
    "15": ("synthetic_soft_red", {"kind": "constant", "size": "260 mm^2"},
           "key, 13 mm, on a punching of 20 mm"),
}  # fmt: skip
SAME = {"16": "10"}  # felt of another contact
#: Corrected unloading: the printed row of contact 02 never meets its loading.
REPAIRED = {"02": {"unloading": Curve(a=7.8, b=3600.0, c=2100.0)}}


def make() -> dict[str, str]:
    """Text of every file by its path below params."""
    action = feltmb.load_action("steinway45")
    files, values, thickness = {}, tomlkit.table(), {}
    for key in action.config.contacts:
        source = SAME.get(key, key)
        base, area, why = CHOICES[source]
        law = {
            "name": "micromechanical",
            "felt": f"a12_{source}",
            "thickness": "1 mm",
            "area": {**area, "note": why},
        }
        contact = action.config.contacts[source]
        probe = action.with_values({f"contacts.{source}.law": {**law, "felt": base}})
        shape = probe.config.contacts[source].micromechanical.area.make()
        if source == key:
            fibers = felt.load_material(base)
            e, load, unload = felt.contact_loop(
                contact.model_copy(update=REPAIRED.get(key, {})), name=key
            )
            fit = felt.fit_contact(
                e, load, unload, shape, fibers=fibers, name=f"a12_{key}",
                about=f"Felt of contact {key} ({contact.label}) of {action.name}, fitted to the "
                "loop of Table A.12; fibers SYNTHETIC, thickness fitted with gamma = pi/2, "
                f"{shape}",
            )  # fmt: skip
            print(
                f"{key}: h {fit.thickness * 1e3:.3g} mm, rms {100 * fit.rms_loading:.2f} % and "
                f"{100 * fit.rms_unloading:.2f} %, friction {100 * fit.friction_share:.1f} %, "
                f"gamma_U {fit.material.unloading.gamma:.3g}, v_max {fit.material.end:.3f} "
                f"{'; '.join(fit.warnings)}"
            )
            rounded = fit.material.model_copy(update={
                "source": {
                    "cite": "thesis, Table A.12, through feltmb.felt.fit_contact",
                    "status": "fitted",
                    "note": f"left over: {100 * fit.rms_loading:.1f} % of the largest force in "
                    f"loading, {100 * fit.rms_unloading:.1f} % in unloading",
                },
            })  # fmt: skip
            files[f"felts/a12_{key}.toml"] = rounded.to_toml()
            thickness[key] = round(fit.thickness * 1e3, 6)
        table = tomlkit.inline_table()
        table["name"] = "micromechanical"
        table["felt"] = f"a12_{source}"
        thick = tomlkit.inline_table()
        thick.update({"value": thickness[source], "unit": "mm", "status": "fitted"})
        table["thickness"] = thick
        inner = tomlkit.inline_table()
        inner.update(law["area"])
        table["area"] = inner
        values[f"contacts.{key}.law"] = table
    doc = tomlkit.document()
    doc.add(tomlkit.comment("Made by tools/make_contact_felts.py. Do not edit."))
    doc["schema"] = 1
    doc["name"] = "steinway45_felt"
    doc["about"] = (
        "steinway45 with the micromechanical contact at all felts: materials fitted to the loops "
        "of Table A.12"
    )
    doc["extends"] = "steinway45"
    doc["values"] = values
    files["steinway45_felt.toml"] = tomlkit.dumps(doc)
    one = tomlkit.document()
    one.add(tomlkit.comment("Made by tools/make_contact_felts.py. Do not edit."))
    one["schema"] = 1
    one["name"] = "steinway45_felt_hammer"
    one["about"] = (
        "steinway45 with the micromechanical contact between hammer and string alone, as in "
        "section 4.2.5 of the thesis"
    )
    one["extends"] = "steinway45"
    one["values"] = {"contacts.06.law": values["contacts.06.law"]}
    files["steinway45_felt_hammer.toml"] = tomlkit.dumps(one)
    return files


def main() -> None:
    for name, text in make().items():
        (HERE / name).write_text(text, encoding="utf-8")
        print(f"wrote {name}")


if __name__ == "__main__":
    main()
