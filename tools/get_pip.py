"""Install pip into the running Python if neither ensurepip nor another pip is available.

The wheel of pip can install itself. It is taken from the first of
1. the disk: Debian's wheels, wheels bundled with other Pythons, the find-links of pip's settings;
2. the package index of pip's settings (PIP_INDEX_URL, PIP_EXTRA_INDEX_URL, pip.conf);
3. Debian's package python3-pip-whl, fetched and unpacked without being installed (needs no root).
"""

from __future__ import annotations

import configparser
import hashlib
import os
import re
import ssl
import subprocess
import sys
import tempfile
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path

WHEEL = re.compile(r"pip-(\d+(?:\.\d+)*)-py(?:2\.py)?3-none-any\.whl$")
DISK = (
    "/usr/share/python-wheels",
    "/usr/lib/python3*/ensurepip/_bundled",
    "/usr/local/lib/python3*/ensurepip/_bundled",
)


def version(name: str) -> tuple[int, ...]:
    """Version of a wheel of pip, () for other names."""
    match = WHEEL.search(name)
    return tuple(int(part) for part in match.group(1).split(".")) if match else ()


def settings() -> dict[str, list[str]]:
    """Values of pip's settings files and environment, split at spaces; the last value is used."""
    home = Path.home()
    config = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    files = [
        "/etc/pip.conf",
        "/etc/xdg/pip/pip.conf",
        home / ".pip/pip.conf",
        config / "pip/pip.conf",
    ]
    named = os.environ.get("PIP_CONFIG_FILE")
    parser = configparser.RawConfigParser()
    parser.read([*files, named] if named else files, encoding="utf-8")
    values = {}
    for section in ("global", "install"):
        if parser.has_section(section):
            values.update({key: text.split() for key, text in parser.items(section)})
    for key in ("index-url", "extra-index-url", "find-links", "cert"):
        text = os.environ.get("PIP_" + key.upper().replace("-", "_"))
        if text:
            values[key] = text.split()
    return values


def from_disk(links: list[str]) -> Path | None:
    """Newest wheel of pip on this disk."""
    folders = [path for pattern in DISK for path in Path("/").glob(pattern.lstrip("/"))]
    folders += [Path(link.removeprefix("file://")) for link in links]
    wheels = [path for folder in folders for path in folder.glob("pip-*.whl") if version(path.name)]
    return max(wheels, key=lambda path: version(path.name), default=None)


def from_index(values: dict[str, list[str]], folder: Path) -> Path | None:
    """Newest wheel of pip in the indexes of pip's settings, its hash checked."""
    certificates = ssl.create_default_context(cafile=values.get("cert", [None])[0])

    def read(url: str) -> bytes:
        context = certificates if url.startswith("https:") else None
        with urllib.request.urlopen(url, context=context, timeout=60) as answer:
            return answer.read()

    for index in values.get("index-url", []) + values.get("extra-index-url", []):
        page = index.rstrip("/") + "/pip/"
        try:
            links = re.findall(r'href="([^"]+)"', read(page).decode())
            links = [link for link in links if version(link.partition("#")[0])]
            if not links:
                continue
            link = max(links, key=lambda link: version(link.partition("#")[0]))
            url, _, digest = urllib.parse.urljoin(page, link.replace("&amp;", "&")).partition("#")
            data = read(url)
        except OSError as error:
            print(f"{page}: {error}", file=sys.stderr)
            continue
        kind, _, expected = digest.partition("=")
        if expected and hashlib.new(kind, data).hexdigest() != expected:
            print(f"{url}: the hash is wrong", file=sys.stderr)
            continue
        path = folder / Path(urllib.parse.urlparse(url).path).name
        path.write_bytes(data)
        return path
    return None


def from_debian(folder: Path) -> Path | None:
    """Wheel in Debian's package python3-pip-whl."""
    try:
        subprocess.run(["apt-get", "download", "python3-pip-whl"], cwd=folder, check=True)
        package = next(folder.glob("*.deb"))
        subprocess.run(["dpkg-deb", "-x", package, folder], check=True)
    except (OSError, subprocess.CalledProcessError, StopIteration) as error:
        print(f"python3-pip-whl: {error}", file=sys.stderr)
        return None
    return next(folder.glob("usr/share/python-wheels/pip-*.whl"), None)


def candidates(folder: Path) -> Iterator[Path | None]:
    """Wheels in the order in which they are tried."""
    values = settings()
    yield from_disk(values.get("find-links", []))
    yield from_index(values, folder)
    yield from_debian(folder)


def main() -> None:
    """Install pip, or report what was tried."""
    with tempfile.TemporaryDirectory() as folder:
        for wheel in candidates(Path(folder)):
            if wheel is None:
                continue
            print(f"installing {wheel.name} from {wheel.parent}", flush=True)
            command = [sys.executable, str(wheel / "pip"), "install", "--no-index", str(wheel)]
            if subprocess.run(command, check=False).returncode == 0:
                return
    sys.exit("error: no wheel of pip on the disk, in an index of pip's settings or from Debian")


if __name__ == "__main__":
    main()
