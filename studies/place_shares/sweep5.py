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
B = [2.5, 1, 1, 1, 1, 0.1, 0.1]
for z in ([1, 0, 0, 0], [1, 0, 1, 0], [1, 1, 0, 0], [1, 1, 1, 0]):
    show("half " + str(z), lambda n, a: run_ftrl(a, B + z, 2))
P = B + [1, 0, 0, 0]
cx = {}
for n in N:
    d = D[n]
    sp = np.linalg.norm(d["hist"][:, -1] - d["hist"][:, -4], axis=-1) / 1.2
    f = d["weight"].sum(2)[:, 0]
    a = DA[n]
    ratio = a.G[:, 1, 1] / np.maximum(a.G[:, 0, 0], 1e-3)
    turn = (
        np.linalg.norm(
            d["hist"][:, -1] - 2 * d["hist"][:, -4] + d["hist"][:, -7], axis=-1
        )
        / 1.2
    )
    cx[n] = dict(
        speed=np.digitize(sp, [0.3, 0.9]),
        filled=np.digitize(f, [0.3, 0.99]),
        agree=np.digitize(ratio, [0.5, 1.0]),
        turn=np.digitize(turn, [0.15, 0.5]),
    )
for k in ("speed", "filled", "agree", "turn"):
    for ec in (0.3, 1):
        show(f"ctx {k} {ec}", lambda n, a: run_ftrl(a, P, 2, ctx=cx[n][k], etac=ec))


# pieces of three to four minutes, as short recordings
def pieces(f):
    out = []
    for n in N[:3]:
        a = DA[n]
        lo, hi = a.step.min(), a.step.max()
        k = {"hotel": 3, "eth": 2, "zara1": 2}[n]
        for i in range(k):
            b0 = lo + (hi - lo) * i // k
            b1 = lo + (hi - lo) * (i + 1) // k
            out.append(f(a, lambda s, b0=b0, b1=b1: (s >= b0) & (s < b1)))
    return np.array(out)


for eta in (0.5, 1, 2, 4):
    show(f"eta {eta}", lambda n, a: run_ftrl(a, P, eta))
for e in (0.1, 0.3, 1):
    show(
        f"errors {e}", lambda n, a: run_ftrl(a, [2.5, 1, 1, 1, 1, e, e, 1, 0, 0, 0], 2)
    )
show("loss 2", lambda n, a: run_ftrl(a, P, 2, loss=2.0))
show("loss 100", lambda n, a: run_ftrl(a, P, 2, loss=100.0))
