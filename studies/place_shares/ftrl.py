import numpy as np
from off import *


def solve(Es, Gs, prior, eta, s, iters=40):
    d = np.diag(Gs)
    L = (2 * Gs - d[:, None] - d[None]).max() / 2 + 1 / eta
    lp = np.log(prior)
    for _ in range(iters):
        ls = np.log(s)
        g = Es - Gs @ s + (ls - lp) / eta
        ls = ls - g / L * 1.0
        ls -= ls.max()
        s = np.exp(ls)
        s /= s.sum()
        s = np.maximum(s, 1e-9)
        s /= s.sum()
    return s


def run_ftrl(
    a,
    prior,
    eta=1.0,
    ctx=None,
    etac=1.0,
    rho=None,
    use=None,
    sl=None,
    loss=1.0,
    ret=False,
):
    """prior [1+K] of components with network first; ctx [M] int."""
    prior = np.asarray(prior, float)
    c = np.flatnonzero(prior > 0)
    prior = prior[c] / prior.sum()
    rows = np.arange(len(a.step)) if sl is None else np.flatnonzero(sl(a.step))
    E = a.E[rows][:, c]
    G = a.G[rows][:, c][:, :, c]
    F = a.F[rows][:, c[1:] - 1]
    st = a.step[rows]
    seen = a.seen[rows]
    C = len(c)
    eye = np.eye(C)
    cx = np.zeros(len(rows), int) if ctx is None else ctx[rows]
    nc = cx.max() + 1
    ES = np.zeros((nc, C))
    GS = np.zeros((nc, C, C))
    s = prior.copy()
    sc = np.tile(prior, (nc, 1))
    gain = res = aw = most = 0.0
    wait = []
    used = np.full(len(rows), np.nan)
    for t in np.unique(st):
        new = False
        while wait and wait[0][0] <= t - 12:
            _, idx, shares, risk, exp = wait.pop(0)
            aw = max(aw - exp, 0)
            res = max(res - risk, 0)
            m = seen[idx]
            ok = idx[m]
            if len(ok):
                sh = shares[m]
                u = (E[ok] * sh).sum(1) - 0.5 * np.einsum("ncd,nc,nd->n", G[ok], sh, sh)
                used[ok] = u
                np.add.at(ES, cx[ok], E[ok])
                np.add.at(GS, cx[ok], G[ok])
                new = True
                net = E[ok, 0] - 0.5 * G[ok, 0, 0]
                gain = min(gain + net.sum() - u.sum(), loss * most)
        if new:
            s = solve(ES.sum(0), GS.sum(0), prior, eta, s)
            sc = (
                np.array(
                    [
                        solve(
                            (1 - rho) * ES[k] + rho * ES.sum(0),
                            (1 - rho) * GS[k] + rho * GS.sum(0),
                            prior,
                            eta,
                            sc[k],
                        )
                        for k in range(nc)
                    ]
                )
                if rho is not None
                else np.array([solve(ES[k], GS[k], s, etac, sc[k]) for k in range(nc)])
                if ctx is not None
                else s[None]
            )
        idx = np.flatnonzero(st == t)
        exp = G[idx, 0, 0].sum() / 2
        aw += exp
        most = max(most, aw)
        shares = sc[cx[idx]] if ctx is not None else np.tile(s, (len(idx), 1))
        within = np.einsum("ncd,nc,nd->n", G[idx], shares, shares)
        risk = np.maximum(
            (F[idx] * shares[:, 1:]).sum(1) - (within - G[idx, 0, 0]) / 2, 0
        ).sum()
        part = min(max(loss * most + gain - res, 0) / max(risk, 1e-12), 1)
        shares = part * shares + (1 - part) * eye[0]
        res += part * risk
        wait.append((t, idx, shares, part * risk, exp))
    ok = ~np.isnan(used)
    late = ok & (st > (st.min() + st.max()) / 2)
    S0 = E[:, 0] - 0.5 * G[:, 0, 0]
    r = [100 * (used[m].sum() / S0[m].sum() - 1) for m in (ok, late)]
    return (r, s, sc) if ret else r
