"""The thesis's own gap: the numbers of two impacts that its one printed string does not reach.

The diagnosis starts from one string and names the impedance of three, which `steinway45` has since.

feltmb gap diagnose examples/thesis_gap/model.py examples/thesis_gap/records/*.csv -o report/

The numbers are those of table_4_3.toml; `python examples/thesis_gap/model.py` writes the records
from it anew.
"""

from pathlib import Path

from feltmb.adapters import load_impacts
from feltmb.data import write_record

HERE = Path(__file__).parent
model, effects, records = load_impacts(HERE / "table_4_3.toml")

if __name__ == "__main__":
    for record in records:
        write_record(record, HERE / "records" / f"{record.name}.csv", force=True)
