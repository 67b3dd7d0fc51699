from sweep2 import *
import pickle, os

G0 = [
    "rw:near:.4",
    "rw:manner:.15",
    "shift:enear:1",
    "pull:near:.4",
    "pull:gait:.4",
    "blend:near:.5",
]
if not os.path.exists("DA3.pkl"):
    DA = {n: A(D[n], *arrays(D[n], BASE + G0, batch=32)) for n in N}
    pickle.dump(DA, open("DA3.pkl", "wb"))
DA = pickle.load(open("DA3.pkl", "rb"))


def show(label, f):
    r = np.array([f(DA[n]) for n in N])
    print(
        f"{label:40s}",
        np.round(r[:, 0], 1),
        np.round(r[:, 1], 1),
        "%.2f %.2f" % tuple(r.mean(0)),
        flush=True,
    )


Z = [0] * len(G0)
for net in (0.5, 1.2, 2.5, 5):
    for eta in (1, 3, 10):
        show(
            f"ftrl net {net} eta {eta}",
            lambda a: run_ftrl(a, [net, 1, 1, 1, 1, 0.1, 0.1] + Z, eta),
        )
show("errors .5", lambda a: run_ftrl(a, [2.5, 1, 1, 1, 1, 0.5, 0.5] + Z, 2))
for k, g in enumerate(G0):
    z = list(Z)
    z[k] = 1
    show("ftrl +" + g, lambda a: run_ftrl(a, [2.5, 1, 1, 1, 1, 0.1, 0.1] + z, 2))
show(
    "ftrl +all", lambda a: run_ftrl(a, [2.5, 1, 1, 1, 1, 0.1, 0.1] + [0.5] * len(G0), 2)
)
