"""Multiplications and divisions of a filter epoch: the rule of the S3EKF paper's figure 7, and the real update's.

The paper (Chen, Zhang, Huo 2012) does not print its counting rule. The one here reproduces all three numbers that it
gives: no gain at 7 satellites, about 8.1 % at 8, more than 50 % at 15. It counts multiplications and divisions with
dense H; one satellite is two rows, a state of N elements:

                              batch, m = 2 n rows        sequential, each satellite
    P H'                      N^2 m                      2 N^2
    H P H'                    N m^2                      4 N
    inverse                   m^3                        6
    K = P H' S^-1             N m^2                      4 N
    K v                       N m                        2 N
    K H                       N^2 m                      2 N^2
    (I - K H) P, triangle     N^2 (N + 1) / 2            N^2 (N + 1) / 2
    prediction, both          N^2 (N + 1) / 2 + N^2

The counts of starwise's own update are those of the loops in `starwise.kernels.update`, `compressed` and `process`,
square roots counted like divisions; tests run these very loops with numbers that count and compare.
"""

from collections.abc import Sequence
from typing import Final

STATES: Final = (11, 13, 15, 17)
"""9 kinematic states and two for every constellation: 1 to 4 of them."""
SATELLITES: Final = tuple(range(1, 61))
NK: Final = 9


def paper_prediction(states: int) -> float:
    """Operations of a prediction under the paper's rule."""
    return states**2 * (states + 1) / 2 + states**2


def paper_batch(satellites: int, states: int = 13) -> float:
    """Operations of an EKF epoch, all satellites at once, under the paper's rule."""
    N, m = states, 2 * satellites
    gain = N * N * m + N * m * m + m**3 + N * m * m
    return paper_prediction(N) + gain + N * m + N * N * m + N * N * (N + 1) / 2


def paper_sequential(satellites: int, states: int = 13) -> float:
    """Operations of an S3EKF epoch under the paper's rule."""
    N = states
    each = 2 * N * N + 4 * N + 6 + 4 * N + 2 * N + 2 * N * N + N * N * (N + 1) / 2
    return paper_prediction(N) + satellites * each


def own_prediction(states: int) -> int:
    """Operations of `starwise.kernels.process.predict` with 9 kinematic states, G and M given."""
    N, nc = states, (states - NK) // 2
    # Phi P, P Phi': per axis and column 3 + 2 + 1 products; a clock has one. The same for x.
    rows = 2 * N * (3 * 6 + nc)
    state = 3 * 6 + nc
    noise = 9 * 9
    # Per pair of clocks: bias dt + drift dt^3 / 3 (a power counts as two), dt^2 / 2 twice, drift dt.
    clocks = nc * nc * (1 + 4 + 3 + 3 + 1)
    symmetric = N * (N - 1) // 2
    return rows + state + noise + clocks + symmetric


def own_sequential(satellites: int, states: int = 13) -> int:
    """Operations of `starwise.kernels.update.update_sequential`: code and rate of every satellite, all used."""
    N = states
    innovation = 3 + 6
    products = 9 * N  # P h of code (3) and rate (6)
    S = 6 + 6 + 3
    inverse = 1 + 2 + 3  # 1 / s11; determinant; three elements over it
    nis = 4 + 2
    gain = 4 * N
    return satellites * (innovation + products + S + inverse + nis + 2 * N + gain + 2 * N * N)


def own_batch(satellites: int, states: int = 13) -> int:
    """Operations of `starwise.kernels.update.update_batch`: code and rate of every satellite, all used."""
    N = states
    total = 0
    for k in range(satellites):
        R = 2 * k  # rows accepted before
        grow = R * (R - 1) // 2 + 3 * R
        total += 9 + 9 * N + 9 * R + 15 + 2 * grow + R
        total += 10  # decision
        total += 2 + 1 + 1 + 3 + 2  # root, y, l21, root of what is left, y
    rows = 2 * satellites
    return total + N * rows * (rows - 1) // 2 + rows * (1 + 2 * N) + rows * N * N


def own_compressed(satellites: int, states: int = 13) -> int:
    """Operations of `starwise.kernels.compressed.update_compressed`, code and rate of every satellite.

    9 kinematic states; the normal matrix has full rank.
    """
    N = states
    k = N - 3
    each = (3 + 1 + 1 + 1 + 3 + 6 + 3) + (6 + 1 + 3 + 6 + 3 + 6 + 9 + 1 + 1 + 3 + 3)
    factor = sum(1 + j + 2 + j + 1 + (k - j) * (j + 1) for j in range(k))
    pairs = k + 0
    for p in range(0, k, 2):
        pairs += (k - p) * (2 + 2 * N) + (k - p) + 2 * (k - p - 1)
        pairs += 3 + 3 + 4 + 2 + N * (2 + 4 + 2 * N)
    return satellites * each + factor + pairs


def operation_gain(satellites: Sequence[int] = SATELLITES, states: Sequence[int] = STATES) -> list[dict[str, float]]:
    """Part of the operations that the sequential form saves, by number of satellites and of states (figure 7).

    Returns
    -------
    list of dict
        ``n``, ``states``; ``paper_rule``: 1 - sequential / batch under the paper's rule; ``own_rule``: the same of
        starwise's own loops, prediction included; ``own_rule_compressed``: of the compressed update against the
        batch; ``own_batch``, ``own_sequential``, ``own_compressed``: operations of the update alone.
    """
    table = []
    for N in states:
        predict = own_prediction(N)
        for n in satellites:
            batch, sequential, compressed = own_batch(n, N), own_sequential(n, N), own_compressed(n, N)
            table.append(
                {
                    "n": n,
                    "states": N,
                    "paper_rule": 1.0 - paper_sequential(n, N) / paper_batch(n, N),
                    "own_rule": 1.0 - (predict + sequential) / (predict + batch),
                    "own_rule_compressed": 1.0 - (predict + compressed) / (predict + batch),
                    "own_batch": batch,
                    "own_sequential": sequential,
                    "own_compressed": compressed,
                }
            )
    return table
