import numpy as np, sys, time


def load(n):
    d = np.load(f"{n}.npz")
    return {k: d[k] for k in d.files}


def norm(w):
    return w / np.maximum(w.sum(-1, keepdims=True), 1e-9)


def pick(w, rng, P):
    """[B,P] indices drawn evenly by w [B,U], in random order per row."""
    c = np.cumsum(norm(w), -1)
    q = (np.arange(P) + 0.5) / P
    i = (c[:, None, :] < q[None, :, None]).sum(-1)
    i = np.minimum(i, w.shape[1] - 1)
    p = rng.permuted(np.tile(np.arange(P), (len(w), 1)), axis=1)
    return np.take_along_axis(i, p, 1)


def dist(A, B):
    q = (
        (A * A).sum(-1)[:, :, None]
        + (B * B).sum(-1)[:, None]
        - 2 * A @ B.swapaxes(1, 2)
    )
    return np.sqrt(np.maximum(q, 0) / 12)


def components(b, spec, rng):
    """X [B,n,24], W [B,C,n], far [B,C-1], names."""
    B, P = b["off"].shape[:2]
    own = b["off"].reshape(B, P, 24)
    wt = b["weight"]
    U = wt.shape[2]
    on = b["onward"].reshape(B, U, 24).copy()
    mean = own.mean(1, keepdims=True)
    err = on[:, 32:].copy()
    on[:, 32:] += mean
    NM = dict(near=0, around=1, manner=2, gait=3, enear=4, earound=5)
    X = [own, on]
    n = P + U
    memo = {}
    rows = []  # (name, list of (block offset, weights))
    D0 = dist(own, own)
    Dw = dist(own, on)
    spread = D0.mean((1, 2))

    def full():
        return np.zeros((B, 0))

    W = [("network", 0, np.full((B, P), 1 / P), None)]
    out = []
    far = []
    names = []

    def add(name, parts, fr):
        names.append(name)
        out.append(parts)
        far.append(fr)

    blocks = [own, on]
    at = [0, P]
    tot = P + U

    def block(x):
        nonlocal tot
        blocks.append(x)
        at.append(tot)
        tot += x.shape[1]
        return len(blocks) - 1

    for s in spec:
        kind, *a = s.split(":")
        if kind in NM:  # plain component
            w = wt[:, NM[kind]]
            f = w.sum(1)
            add(
                s,
                [(0, np.repeat((1 - f)[:, None] / P, P, 1)), (1, w)],
                np.einsum("bu,bu->b", w, Dw.mean(1)),
            )
        elif kind == "shift":  # shift:ekernel:scale
            e = NM[a[0]]
            w = wt[:, e, 32:]
            f = w.sum(1)
            m = np.einsum("bu,bud->bd", norm(w), err)
            sh = m * (float(a[1]) * f)[:, None]
            k = block(own + sh[:, None])
            add(s, [(k, np.full((B, P), 1 / P))], np.sqrt((sh**2).sum(1) / 12))
        elif kind == "pull":  # pull:kernel:lambda  shift to mean of ways
            w = wt[:, NM[a[0]]]
            f = w.sum(1)
            m = np.einsum("bu,bud->bd", norm(w), on) - mean[:, 0]
            sh = m * (float(a[1]) * f)[:, None]
            k = block(own + sh[:, None])
            add(s, [(k, np.full((B, P), 1 / P))], np.sqrt((sh**2).sum(1) / 12))
        elif kind == "blend":  # blend:kernel:lambda (lambda of the way)
            w = wt[:, NM[a[0]]]
            f = w.sum(1)
            lam = float(a[1])
            i = pick(w, rng, P)
            way = np.take_along_axis(on, i[..., None], 1)
            x = (1 - lam) * own + lam * way
            k = block(x)
            g = np.sqrt(((x - own) ** 2).sum(-1) / 12).mean(1)
            add(
                s,
                [
                    (0, np.repeat((1 - f)[:, None] / P, P, 1)),
                    (k, np.repeat(f[:, None] / P, P, 1)),
                ],
                f * g,
            )
        elif kind == "half":
            w = wt[:, NM[a[0]]]
            f = w.sum(1)
            lam = float(a[1])
            x = lam * on[:, :32] + (1 - lam) * mean
            key = ("half", lam)
            if key not in memo:
                memo[key] = block(x)
            k = memo[key]
            w = w[:, :32]
            add(
                s,
                [(0, np.repeat((1 - f)[:, None] / P, P, 1)), (k, w)],
                np.einsum("bu,bu->b", w, dist(own, x).mean(1)),
            )
        elif kind == "sharp":
            c = float(a[0])
            x = mean + c * (own - mean)
            k = block(x)
            add(
                s,
                [(k, np.full((B, P), 1 / P))],
                np.sqrt(((x - own) ** 2).sum(-1) / 12).mean(1),
            )
        elif kind == "rw":  # rw:kernel:h relative to spread
            w = wt[:, NM[a[0]]]
            f = w.sum(1)
            h = float(a[1]) * spread
            K = np.exp(-(Dw / h[:, None, None]))
            s_i = np.einsum("bu,bpu->bp", norm(w), K)
            r = norm(s_i + 1e-6)
            x = (1 - f)[:, None] / P + f[:, None] * r
            ex = np.maximum(x - 1 / P, 0)
            de = np.maximum(1 / P - x, 0)
            t = np.maximum(ex.sum(1), 1e-9)
            add(s, [(0, x)], np.einsum("bi,bij,bj->b", ex, D0, de) / t)
        elif kind == "rwg":  # gaussian kernel
            w = wt[:, NM[a[0]]]
            f = w.sum(1)
            h = float(a[1]) * spread
            K = np.exp(-0.5 * (Dw / h[:, None, None]) ** 2)
            r = norm(np.einsum("bu,bpu->bp", norm(w), K) + 1e-6)
            x = (1 - f)[:, None] / P + f[:, None] * r
            ex = np.maximum(x - 1 / P, 0)
            de = np.maximum(1 / P - x, 0)
            t = np.maximum(ex.sum(1), 1e-9)
            add(s, [(0, x)], np.einsum("bi,bij,bj->b", ex, D0, de) / t)
        else:
            raise ValueError(s)
    Xs = np.concatenate(blocks, 1)
    W = np.zeros((B, 1 + len(out), tot), np.float32)
    W[:, 0, :P] = 1 / P
    for c, parts in enumerate(out):
        for k, w in parts:
            W[:, 1 + c, at[k] : at[k] + w.shape[1]] += w
    return Xs.astype(np.float32), W, np.array(far).T, names


def arrays(d, spec, batch=64, seed=0):
    rng = np.random.default_rng(seed)
    M = len(d["step"])
    Es, Gs, Fs = [], [], []
    for i in range(0, M, batch):
        b = {k: d[k][i : i + batch] for k in ("off", "onward", "weight")}
        X, W, F, names = components(b, spec, rng)
        D = dist(X, X)
        G = (W @ D) @ W.swapaxes(1, 2)
        t = d["truth"][i : i + batch].reshape(len(X), 1, 24)
        e = dist(X, t)[:, :, 0]
        Es.append(np.einsum("bcn,bn->bc", W, e))
        Gs.append(G)
        Fs.append(F)
    return (
        np.concatenate(Es).astype(float),
        np.concatenate(Gs).astype(float),
        np.concatenate(Fs).astype(float),
    )


STEPS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.9)


class A:
    """Arrays of one recording, ledger and all."""

    def __init__(s, d, E, G, F):
        s.step = d["step"]
        s.E, s.G, s.F = E, G, F
        s.seen = ~np.isnan(E[:, 0])


def run(
    a,
    prior,
    rate=0.7,
    alone=0.2,
    steps=STEPS,
    use=None,
    sl=None,
    loss=1.0,
    ledger=True,
    ret=False,
):
    """prior: list of first weights per component (0: not used)."""
    use = [k for k, p in enumerate(prior) if p > 0]
    c = [0] + [1 + k for k in use]
    rows = np.arange(len(a.step)) if sl is None else np.flatnonzero(sl(a.step))
    E = a.E[rows][:, c]
    G = a.G[rows][:, c][:, :, c]
    F = a.F[rows][:, use]
    st = a.step[rows]
    seen = a.seen[rows]
    C = len(c)
    eye = np.eye(C)
    ex = [eye[0]] + [(1 - s) * eye[0] + s * eye[k] for k in range(1, C) for s in steps]
    ex = np.array(ex)
    pr = np.repeat([prior[k] for k in use], len(steps))
    lw = np.log(np.append(alone, (1 - alone) * pr / pr.sum()))
    S = E @ ex.T - 0.5 * np.einsum("ncd,ec,ed->ne", G, ex, ex)
    gain = res = aw = most = 0.0
    wait = []
    used = np.full(len(rows), np.nan)
    for t in np.unique(st):
        while wait and wait[0][0] <= t - 12:
            _, idx, shares, risk, exp = wait.pop(0)
            aw = max(aw - exp, 0)
            res = max(res - risk, 0)
            ok = idx[seen[idx]]
            if len(ok):
                u = E[ok] @ shares - 0.5 * np.einsum(
                    "ncd,c,d->n", G[ok], shares, shares
                )
                used[ok] = u
                lw = lw - rate * S[ok].sum(0)
                lw -= lw.max()
                gain = min(gain + S[ok, 0].sum() - u.sum(), loss * most)
        idx = np.flatnonzero(st == t)
        exp = G[idx, 0, 0].sum() / 2
        aw += exp
        most = max(most, aw)
        w = np.exp(lw - lw.max())
        shares = w @ ex / w.sum()
        within = np.einsum("ncd,c,d->n", G[idx], shares, shares)
        risk = np.maximum(F[idx] @ shares[1:] - (within - G[idx, 0, 0]) / 2, 0).sum()
        part = (
            min(max(loss * most + gain - res, 0) / max(risk, 1e-12), 1) if ledger else 1
        )
        shares = part * shares + (1 - part) * eye[0]
        res += part * risk
        wait.append((t, idx, shares, part * risk, exp))
    ok = ~np.isnan(used)
    late = ok & (st > (st.min() + st.max()) / 2)
    r = [100 * (used[m].sum() / S[m, 0].sum() - 1) for m in (ok, late)]
    if ret:
        return r, shares, used, S[:, 0]
    return r


BASE = ["near", "around", "manner", "gait", "enear", "earound"]
