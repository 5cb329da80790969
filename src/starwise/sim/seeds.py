"""Independent random streams, one per error source, all from one seed.

A stream is found by its name, not by the order in which it was asked for: turning one error source off, or adding
one, leaves every other source's numbers as they were.
"""

import hashlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Streams:
    """Random generators by name, from a seed and a run number.

    Law: ``streams(s, r)("a")`` depends on s, r and the text "a" only, on every platform and in every process.

    Attributes
    ----------
    seed : int
        Seed of the scenario, not negative.
    run : int
        Number of the Monte Carlo run, from 0.
    """

    seed: int
    run: int = 0

    def __call__(self, name: str) -> np.random.Generator:
        """Generator of an error source, at its beginning: two calls with one name give the same numbers.

        Parameters
        ----------
        name : str
            The source, like ``clock`` or ``code/G05/1C``.
        """
        digest = hashlib.sha256(name.encode()).digest()
        words = np.frombuffer(digest[:16], dtype="<u4")
        key = (self.run, *(int(word) for word in words))
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=key)))

    def __getitem__(self, name: str) -> np.random.Generator:
        """Same as calling."""
        return self(name)


def streams(seed: int, run: int = 0) -> Streams:
    """Random streams of a scenario's seed and a Monte Carlo run.

    Parameters
    ----------
    seed, run : int
        Not negative.
    """
    if seed < 0 or run < 0:
        raise ValueError(f"seed {seed} and run {run} must not be negative")
    return Streams(seed, run)
