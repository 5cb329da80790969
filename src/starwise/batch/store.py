"""Files by path or by URL (`fsspec`: ``s3://bucket/...``), for workers that may be on another machine."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from starwise.errors import StarwiseError


def is_url(where: str) -> bool:
    """Whether a place is a URL, not a path."""
    return "://" in where


def filesystem(url: str) -> tuple[Any, str]:
    """File system of a URL and the path in it; how to reach it is fsspec's own configuration.

    Raises
    ------
    StarwiseError
        The package for this kind of URL is not installed, or there is no such kind.
    """
    try:
        from fsspec.core import url_to_fs  # type: ignore[import-untyped]

        fs, path = url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        raise StarwiseError(f"a URL of this kind needs a package ({error})", file=url) from None
    except (ValueError, OSError) as error:
        raise StarwiseError(f"cannot be reached ({_said(error)})", file=url) from None
    return fs, str(path)


def _said(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


@contextmanager
def fetched(places: tuple[str, ...]) -> Iterator[dict[str, Path]]:
    """Local file of every place: of a path itself, of a URL a copy that is gone afterwards.

    Raises
    ------
    StarwiseError
        A URL cannot be read.
    """
    with TemporaryDirectory(prefix="starwise-") as folder:
        found: dict[str, Path] = {}
        for number, place in enumerate(places):
            if not is_url(place):
                found[place] = Path(place)
                continue
            local = Path(folder, f"{number:02d}-{place.rpartition('/')[2]}")
            fs, path = filesystem(place)
            try:
                fs.get_file(path, str(local))
            except Exception as error:  # every store has its own
                raise StarwiseError(f"cannot be read ({_said(error)})", file=place) from None
            found[place] = local
        yield found


def fingerprint(place: str) -> str:
    """Hash of a file's content; of a URL, of what its store says of it (size, tag, date) without fetching it.

    Raises
    ------
    StarwiseError
        It is not there.
    """
    if is_url(place):
        fs, path = filesystem(place)
        try:
            return str(fs.ukey(path))
        except Exception as error:
            raise StarwiseError(f"cannot be read ({_said(error)})", file=place) from None
    try:
        about = os.stat(place)
    except OSError as error:
        raise StarwiseError(f"cannot be read: {error.strerror}", file=place) from None
    return _content_hash(place, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=64)
def _content_hash(path: str, _size: int, _mtime_ns: int) -> str:
    """Navigation files are those of many units: hashed once in a process while they stay the same."""
    from starwise.io.files import sha256

    return sha256(path)


def put_files(files: Mapping[str, Path | bytes], place: str) -> None:
    """Write files into a folder, in their order, each whole or not there.

    Raises
    ------
    StarwiseError
        It cannot be written.
    """
    try:
        if is_url(place):
            fs, path = filesystem(place)
            for name, content in files.items():
                fs.pipe_file(f"{path}/{name}", content if isinstance(content, bytes) else content.read_bytes())
            return
        folder = Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            beside = folder / f".{name}.{os.getpid()}.tmp"
            beside.write_bytes(content if isinstance(content, bytes) else content.read_bytes())
            beside.replace(folder / name)
    except StarwiseError:
        raise
    except Exception as error:
        raise StarwiseError(f"cannot be written ({_said(error)})", file=place) from None


def remove_files(names: tuple[str, ...], place: str) -> None:
    """Remove files from a folder; those that are not there are no error."""
    if is_url(place):
        fs, path = filesystem(place)
        for name in names:
            try:
                fs.rm_file(f"{path}/{name}")
            except FileNotFoundError:
                continue
            except Exception as error:
                raise StarwiseError(f"cannot be removed ({_said(error)})", file=f"{place}/{name}") from None
        return
    for name in names:
        try:
            Path(place, name).unlink(missing_ok=True)
        except OSError as error:
            raise StarwiseError(f"cannot be removed ({error.strerror})", file=Path(place, name)) from None


def remove_leftovers(place: str) -> None:
    """Remove what a killed process left in a folder under temporary names; at a URL nothing is half-written."""
    if is_url(place):
        return
    for path in Path(place).glob(".*.tmp"):
        path.unlink(missing_ok=True)


def sizes(names: tuple[str, ...], place: str) -> dict[str, int]:
    """Sizes of those files of a folder that are there."""
    if not is_url(place):
        paths = {name: Path(place, name) for name in names}
        return {name: path.stat().st_size for name, path in paths.items() if path.is_file()}
    fs, path = filesystem(place)
    try:
        return {
            str(item["name"]).rpartition("/")[2]: int(item["size"] or 0)
            for item in fs.ls(path, detail=True)
            if str(item["name"]).rpartition("/")[2] in names
        }
    except FileNotFoundError:
        return {}
    except Exception as error:
        raise StarwiseError(f"cannot be read ({_said(error)})", file=place) from None


def read_json(place: str) -> dict[str, Any] | None:
    """Object of a JSON file; None if it is not there, or not one."""
    try:
        if is_url(place):
            fs, path = filesystem(place)
            content = fs.cat_file(path)
        else:
            content = Path(place).read_bytes()
        record = json.loads(content)
    except (OSError, ValueError):
        return None
    except StarwiseError:
        raise
    except Exception as error:
        raise StarwiseError(f"cannot be read ({_said(error)})", file=place) from None
    return record if isinstance(record, dict) else None


def hash_of(value: Any) -> str:
    """Hash of plain values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
