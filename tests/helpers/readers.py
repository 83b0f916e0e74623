"""Every reader of a file, by the ending of the file."""

import feltmb
from feltmb.fiber import read_compression
from feltmb.graphics.viewer import read_curves
from feltmb.run.stroke import load_stroke
from unmodeled.data import read_record
from unmodeled.files import access as files

READERS = {
    ".toml": [
        feltmb.load_action,
        load_stroke,
        feltmb.load_targets,
        files.read_toml,
        lambda p: feltmb.load_action(extending(p)),
        lambda p: feltmb.load_action(with_felt(p)),
    ],
    ".csv": [
        load_stroke,
        lambda p: read_compression(p, v_f0=0.1, area=1e-4),
        read_curves,
        lambda p: read_record(p, outputs=["q"]),
    ],
    ".nc": [feltmb.load_run, lambda p: read_record(p, outputs=["q"])],
    ".mat": [lambda p: read_record(p, outputs=["q"])],
    ".npz": [files.read_npz],
    ".json": [files.read_json],
}


def extending(path):
    other = path.parent / "mine.toml"
    other.write_text(f'schema = 1\nname = "a"\nextends = "{path.name}"\n')
    return other


def with_felt(path):
    other = path.parent / "mine.toml"
    other.write_text(f'schema = 1\n[contacts.01]\nmicromechanical = {{ felt = "{path.name}" }}\n')
    return other
