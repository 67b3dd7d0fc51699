import sys, time
from off import *
from ftrl import *

N = ["hotel", "eth", "zara1", "bo"]


def seen(d):
    m = ~np.isnan(d["truth"][:, 0, 0])
    return {k: v[m] for k, v in d.items() if k != "scored"}


D = {n: seen(load(n)) for n in N}


def sweep(group, prior=1.0, names=N):
    t = time.time()
    DA = {}
    for n in names:
        DA[n] = A(D[n], *arrays(D[n], BASE + group, batch=32))
    base = [1, 1, 1, 1, 0.1, 0.1] + [0] * len(group)

    def show(label, f):
        r = np.array([f(DA[n]) for n in names])
        print(
            f"{label:28s}",
            np.round(r[:, 0], 1),
            np.round(r[:, 1], 1),
            "%.2f %.2f" % tuple(r.mean(0)),
            flush=True,
        )

    show("base", lambda a: run(a, base))
    for k in range(6, len(base)):
        p = list(base)
        p[k] = prior
        show("+" + group[k - 6], lambda a: run(a, p))
    if len(group) > 1:
        p = list(base)
        p[6:] = [prior] * len(group)
        show("+all", lambda a: run(a, p))
    print("%.0f s" % (time.time() - t), flush=True)
    return DA


if __name__ == "__main__":
    DA = sweep(
        [
            "rw:near:.15",
            "rw:near:.4",
            "rwg:near:.5",
            "rw:around:.15",
            "rw:manner:.15",
            "rw:gait:.15",
            "rw:enear:.15",
            "rw:gait:.4",
        ]
    )
    p = [1.2, 1, 1, 1, 1, 0.1, 0.1]
    for eta in (0.3, 1, 3):
        r = np.array([run_ftrl(DA[n], p + [0] * 8, eta) for n in N])
        print("ftrl", eta, np.round(r.T, 1).tolist(), r.mean(0), flush=True)
    sweep(["shift:enear:1", "shift:earound:1"])
    sweep(["pull:near:.4", "pull:around:.4", "pull:gait:.4"])
    sweep(["blend:near:.5", "blend:around:.5", "blend:gait:.5"])
    sweep(["sharp:.7"])
