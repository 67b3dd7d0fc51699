from sweep2 import *
import pickle, os


def show(label, f, DA):
    r = np.array([f(DA[n]) for n in N])
    print(
        f"{label:40s}",
        np.round(r[:, 0], 1),
        np.round(r[:, 1], 1),
        "%.2f %.2f" % tuple(r.mean(0)),
        flush=True,
    )


B = [2.5, 1, 1, 1, 1, 0.1, 0.1]
for lam in (0.5, 0.7):
    G = [f"half:{k}:{lam}" for k in ("near", "around", "manner", "gait")]
    DA = {n: A(D[n], *arrays(D[n], BASE + G, batch=32)) for n in N}
    pickle.dump(DA, open(f"DA4_{lam}.pkl", "wb"))
    for k, g in enumerate(G):
        z = [0] * 4
        z[k] = 1
        show(g, lambda a: run_ftrl(a, B + z, 2), DA)
    show("all", lambda a: run_ftrl(a, B + [1] * 4, 2), DA)
    show(
        "all but gait, hedge", lambda a: run(a, [1, 1, 1, 1, 0.1, 0.1, 1, 1, 1, 0]), DA
    )
