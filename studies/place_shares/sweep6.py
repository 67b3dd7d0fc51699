from sweep2 import *
import pickle


def show(label, f):
    r = np.array([f(n, DA[n]) for n in N])
    print(
        f"{label:40s}",
        np.round(r[:, 0], 1),
        np.round(r[:, 1], 1),
        "%.2f %.2f" % tuple(r.mean(0)),
        flush=True,
    )


DA = pickle.load(open("DA4_0.5.pkl", "rb"))
P = [2.5, 1, 1, 1, 1, 0.1, 0.1, 1, 0, 0, 0]


def cls(n, edges):
    d = D[n]
    sp = np.linalg.norm(d["hist"][:, -1] - d["hist"][:, -4], axis=-1) / 1.2
    return np.digitize(sp, edges)


for e in ([0.3, 0.9], [0.2], [0.3], [0.2, 0.5, 1.0], [0.5], [0.2, 0.5, 0.9, 1.3]):
    for rho in (0.1,):
        show(
            f"edges {e} rho {rho}",
            lambda n, a: run_ftrl(a, P, 2, ctx=cls(n, e), rho=rho),
        )
e = [0.3, 0.9]
for rho in (0.03, 0.3):
    show(f"edges {e} rho {rho}", lambda n, a: run_ftrl(a, P, 2, ctx=cls(n, e), rho=rho))
P[5] = P[6] = 0.5
for eta in (1, 2):
    show(
        f"edges {e} eta {eta} errors .5",
        lambda n, a: run_ftrl(a, P, eta, ctx=cls(n, e), rho=0.1),
    )
