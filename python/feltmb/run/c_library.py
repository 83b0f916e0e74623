"""A contact law for programs that call C: its text, the library and its header."""

from __future__ import annotations

from pathlib import Path

from feltmb import _core
from feltmb.contact import Law
from feltmb.mechanism import LawChoice, core_law
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import make_folder, write_file

HEADER = "feltmb_felt.h"


@checked
def export_felt_c(
    law: Law | LawChoice | _core.ContactLaw, folder: str | Path, *, force: bool = False
) -> Path:
    """Write a contact law, the library that runs it, and its header, for C and what calls C.

    ``felt.txt`` is the text of ``feltmb_felt_create``: the law to the bit, of any kind. The library
    needs the C library only; no Python, no compiler.

    Parameters
    ----------
    law
        A law (:func:`feltmb.contact.law`), a contact of a mechanism, or the law of an envelope
        (:meth:`feltmb.felt.FeltEnvelope.law`).
    folder
        Folder of the three files; it is made.
    force
        Replace existing files.

    Returns
    -------
    Path
        The library.

    Raises
    ------
    InvalidParameter
        The law is a compiled function, or the package was installed without the library.
    FileExists
        A file exists and ``force`` is false.
    """
    text = _core.write_law(core_law(law))
    package = Path(_core.__file__).parent
    places = (package, package.parents[1] / "cpp" / "include")  # installed, and a clone
    header = next((p / HEADER for p in places if (p / HEADER).is_file()), None)
    library = next((p for p in package.glob("*feltmb_felt.*") if p.suffix != ".h"), None)
    if library is None or header is None:
        raise InvalidParameter(
            f"the library of {HEADER} is not installed beside the extension of feltmb; install the "
            "package anew"
        )
    made = make_folder(Path(folder))
    files = {"felt.txt": text.encode(), **{p.name: p.read_bytes() for p in (header, library)}}
    for name, data in files.items():

        def write(path: Path, data: bytes = data) -> None:
            path.write_bytes(data)

        write_file(made / name, write, force=force)
    return made / library.name
