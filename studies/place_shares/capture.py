"""Cache of every forecast of a watched recording: network's points, recall, truth."""

import sys, warnings

warnings.simplefilter("ignore")
from pathlib import Path
import numpy as np, jax.numpy as jnp
from neurosym_jax.models.place.place import Place, steps_of
from neurosym_jax.models.place import memory as memories
from neurosym_jax.models.disk import find_model, load_model
from neurosym_jax.data.recordings import recordings_in

DATA, THOR, MORE, *NAMES = sys.argv[1:]
E = DATA + "/all/"
M = MORE + "/"
T = THOR + "/"
P = dict(
    eth=("anchors_eth_12", E + "biwi_eth.txt"),
    hotel=("anchors_hotel_12", E + "biwi_hotel.txt"),
    zara1=("anchors_zara1_12", E + "crowds_zara01.txt"),
    bo=("anchors_general_12", M + "tests/bo-360-050-050.txt"),
    MAGNI=("anchors_general_12", T + "THOR-MAGNI_Scenario_5.csv"),
)


class Spy(Place):
    rows = None

    def _expect(self, number):
        n = len(self._awaited)
        super()._expect(number)
        if len(self._awaited) == n or self.rows is None:
            return
        a = self._awaited[-1]
        N = len(a.people)
        tr = self._followed.tracks(number, self.model.config.obs_len)
        hist = np.array(list(tr.values()))[:, -8:]
        self.rows.append(
            dict(
                step=np.full(N, number),
                person=np.array(a.people),
                hist=hist.astype(np.float32),
                off=np.asarray(a.offsets)[:, :N].swapaxes(0, 1),
                onward=np.asarray(a.recall.onward)[:N],
                weight=np.asarray(a.recall.weight)[:N],
                shares=np.tile(a.commitment.shares, (N, 1)).astype(np.float32),
                truth=np.full((N, 12, 2), np.nan, np.float32),
            )
        )

    def _learn(self, a, number):
        for r in reversed(self.rows):
            if r["step"][0] == a.step:
                tr = self._followed.tracks(number, 13)
                for k, p in enumerate(a.people):
                    if p in tr:
                        r["truth"][k] = tr[p][1:] - tr[p][0]
                break
        super()._learn(a, number)


for n in NAMES:
    m, f = P[n]
    model = load_model(find_model(m))
    place = Spy(model)
    place.rows = []
    for tracks in recordings_in(Path(f)):
        for s in steps_of(tracks, model.config.period):
            place.watch_step(s)
    out = {k: np.concatenate([r[k] for r in place.rows]) for k in place.rows[0]}
    sc = place.scored
    print(
        n,
        len(out["step"]),
        sc,
        "%.2f %%" % (100 * (sc.used / sc.network - 1)),
        "drops",
        place.drops,
        flush=True,
    )
    np.savez(f"{n}.npz", scored=np.array(sc), **out)
