"""Is this run consistent? NIS and whiteness of the innovations of a result, from its ledger alone, and a picture."""

import sys
from importlib.resources import as_file, files

import numpy as np

import starwise
from starwise.analysis.consistency import autocorrelation, nis_test
from starwise.constants import ROW_USED
from starwise.signals import sv_name

if len(sys.argv) > 1:
    solution = starwise.read_solution(sys.argv[1])  # a directory written by `starwise solve`
else:
    with as_file(files("starwise.demo") / "data") as data:
        solution = starwise.solve(data / "demo_MO.rnx.gz", data / "demo_MN.rnx.gz")

test = nis_test(solution.nis, np.maximum(solution.dof, 1))
print(f"NIS per degree of freedom {test.per_dof:.2f}; if white and as claimed {test.low:.2f} to {test.high:.2f}")

ledger = solution.ledger
used = (ledger["status"] == ROW_USED) & np.isfinite(ledger["innovation_m"])
print("satellite  epochs  mean, m  sigma, m  claimed, m  correlation of neighbours")
for sv in np.unique(ledger["sv"][used]):
    at = used & (ledger["sv"] == sv)
    v, claimed = ledger["innovation_m"][at], np.sqrt(np.median(ledger["innovation_var_m2"][at]))
    if len(v) > 20:
        rho = float(np.ravel(autocorrelation(v[:, None] - v.mean(), 1))[0])
        print(f"{sv_name(int(sv)):9} {len(v):7} {v.mean():8.2f} {v.std():9.2f} {claimed:11.2f} {rho:12.2f}")
solution.plot.nis(columns=2).savefig("nis.pdf")
print("picture: nis.pdf")
