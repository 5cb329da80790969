"""Observation codes of a file, by system, in RINEX 3 names, and where the reader's kernel puts each field.

RINEX 2 codes (2.11 table A1, 2.12 section 10.1.1) name a band and sometimes the code; the tracking mode must be
supplied. The names taken here are those that other converters take:

======  ====================================================================================================
GPS     C1 1C, P1 1W, C2 2X (civil), P2 2W, C5 5X
GLONASS C1 1C, P1 1P, C2 2C, P2 2P
Galileo C1 1X, C5 5X, C6 6X, C7 7X, C8 8X
BeiDou  C2 2I (or C1, where C2 is not declared), C5 5X, C6 6I, C7 7I, C8 8X
QZSS    C1 1C, C2 2X, C5 5X, C6 6X
SBAS    C1 1C, C5 5X
NavIC   C5 5A, C9 9A
2.12    CA 1C, CB 1X (L1C), CC 2X (L2C), CD 2C (GLONASS)
======  ====================================================================================================

Phase, Doppler and strength of a band carry no code in their name: on band 1 they go with C1 if it is declared, else
P1; on band 2 with P2 if it is declared, else C2; where that code is blank and the other one of the band present, with
the other. RINEX 3 codes are their own names, but BeiDou's B1I: ``C1I`` of version 3.02 is ``C2I`` of the others.
"""

from typing import Final, NamedTuple

import numpy as np

from starwise.constants import N_SYSTEMS, SYSTEMS
from starwise.io.rinex_header import Header, Problems
from starwise.kernels.rinex_records import Layout
from starwise.signals import signal_id

KINDS: Final = "CLDS"

_RINEX2: Final[dict[str, dict[str, str]]] = {
    "G": {"C1": "1C", "P1": "1W", "C2": "2X", "P2": "2W", "C5": "5X", "CA": "1C", "CB": "1X", "CC": "2X"},
    "R": {"C1": "1C", "P1": "1P", "C2": "2C", "P2": "2P", "CA": "1C", "CD": "2C"},
    "E": {"C1": "1X", "C5": "5X", "C6": "6X", "C7": "7X", "C8": "8X"},
    "C": {"C1": "2I", "C2": "2I", "C5": "5X", "C6": "6I", "C7": "7I", "C8": "8X"},
    "J": {"C1": "1C", "C2": "2X", "C5": "5X", "C6": "6X", "CA": "1C", "CB": "1X", "CC": "2X"},
    "S": {"C1": "1C", "C5": "5X", "CA": "1C"},
    "I": {"C5": "5A", "C9": "9A"},
}
_NO_VALUES: Final = "TIX"
"""Transit Doppler (2.11), ionosphere delay and receiver channel (3.05 table A25): not kept."""


class Field(NamedTuple):
    """One column of a record: kind (index in `KINDS`, -1 not kept), signal, and the signal that may take over."""

    kind: int
    name: str = ""
    other: str = ""


def _field2(code: str, system: str, declared: set[str]) -> Field:
    table = _RINEX2[system]
    kind, band = code[:1], code[1:2]
    if system == "C" and band in "12" and (band == "2") != ("C2" in declared):
        return Field(-1)
    if kind in "CP":
        return Field(0, table[code]) if code in table else Field(-1)
    if kind not in "LDS":
        return Field(-1)
    # 2.12: where CA is declared, L1 is the phase of P(Y) and LA that of C/A
    order = "PC" if band == "2" or (band == "1" and "CA" in declared) else "CP"
    known = [c + band for c in order if c + band in table]
    present = [c for c in known if c in declared]
    names = [table[c] for c in present or known[:1]]
    if not names:
        return Field(-1)
    return Field(KINDS.index(kind), names[0], names[1] if len(names) > 1 else "")


def _field3(code: str, system: str, version: float) -> Field:
    kind = KINDS.find(code[:1])
    name = code[1:]
    if kind < 0 or len(name) != 2 or not name.isascii() or not name[0].isdigit() or not name[1].isalpha():
        return Field(-1)
    if system == "C" and (name in ("1I", "1Q") or (name == "1X" and version < 3.025)):
        name = "2" + name[1]
    return Field(kind, name)


def translate(header: Header, line: int, problems: Problems) -> tuple[Layout, dict[str, tuple[str, ...]]]:
    """Layout of a record for the kernels, and the codes in RINEX 3 names by system letter.

    Parameters
    ----------
    header : Header
        With the codes as written.
    line : int
        Line number to report against.
    problems : Problems
        Receives codes that no table knows.
    """
    fields: dict[str, list[Field]] = {}
    if header.version < 3.0:
        codes = header.codes.get("", [])
        for system in SYSTEMS:
            fields[system] = [_field2(code, system, set(codes)) for code in codes]
        for i, code in enumerate(codes):
            if code[0] not in _NO_VALUES and all(fields[s][i].kind < 0 for s in SYSTEMS):
                problems.add(line, f"unknown observation code {code[:4]!a}: not kept")
    else:
        for system, codes in header.codes.items():
            if system not in SYSTEMS:
                problems.add(line, f"observation codes of unknown system {system!a}: not kept")
                continue
            fields[system] = [_field3(code, system, header.version) for code in codes]
            for f, code in zip(fields[system], codes, strict=True):
                if f.kind < 0 and code[0] not in _NO_VALUES:
                    problems.add(line, f"unknown observation code {code[:4]!a}: not kept")
    return _layout(fields, header, line, problems)


def _layout(
    fields: dict[str, list[Field]], header: Header, line: int, problems: Problems
) -> tuple[Layout, dict[str, tuple[str, ...]]]:
    width = max(1, *(len(f) for f in fields.values())) if fields else 1
    shape = (N_SYSTEMS, width)
    layout = Layout(
        n_fields=np.zeros(N_SYSTEMS, dtype=np.int64),
        place=np.full(shape, -1, dtype=np.int64),
        divisor=np.full(shape, 1000.0),
        lli=np.full(shape, -1, dtype=np.int64),
        ssi=np.full(shape, -1, dtype=np.int64),
        n_slots=np.zeros(N_SYSTEMS, dtype=np.int64),
        sig=np.zeros(shape, dtype=np.int16),
        other=np.full(shape, -1, dtype=np.int64),
        per_line=5 if header.version < 3.0 else width,
        # "M" is mixed: there a blank letter is GPS in version 2 and an error in version 3
        system=SYSTEMS.index(header.system) if header.system in SYSTEMS else -int(header.version >= 3.0),
        picoseconds=int(header.version >= 4.015),
    )
    signals: dict[str, tuple[str, ...]] = {}
    for letter, columns in fields.items():
        system = SYSTEMS.index(letter)
        slots: dict[str, int] = {}
        taken: set[tuple[int, str]] = set()
        kept: list[str] = []
        layout.n_fields[system] = len(columns)
        raw = header.codes["" if header.version < 3.0 else letter]
        for i, (column, code) in enumerate(zip(columns, raw, strict=True)):
            if column.kind < 0:
                continue
            if (column.kind, column.name) in taken:
                problems.add(line, f"observation code {KINDS[column.kind]}{column.name} twice: first kept")
                continue
            taken.add((column.kind, column.name))
            kept.append(KINDS[column.kind] + column.name)
            slot = slots.setdefault(column.name, len(slots))
            layout.place[system, i] = 4 * slot + column.kind
            if column.kind == 1:
                layout.lli[system, i] = slot
            if column.kind <= 1 and not any(c.kind == 3 and c.name == column.name for c in columns):
                layout.ssi[system, i] = slot
            layout.sig[system, slot] = signal_id(column.name)
            factor = header.scale.get((letter, code), header.scale.get((letter, ""), 1.0))
            layout.divisor[system, i] = 1000.0 * factor
        for column in columns:
            if column.other and column.other in slots:
                layout.other[system, slots[column.name]] = slots[column.other]
        layout.n_slots[system] = len(slots)
        if kept:
            signals[letter] = tuple(kept)
    return layout, signals
