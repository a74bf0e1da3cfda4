"""`MapPolicy`: a trained map network that answers at once which sensors to place, before anything is simulated.

It goes as greedy search does and then swaps one sensor at a time, both by what the network predicts. Of a candidate
whose link may not carry what it sends, the predicted gain counts as far as that is likely; where it is known what is
sent, it is known whether the link carries that, beside what other sensors of its mount send.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from models.weight_files import check_tensors, digest_of, header_in_order, read_tensors
from placement_env.candidates.candidates import Candidates
from placement_env.candidates.outlook.outlook import Outlook, outlook
from placement_env.candidates.places import ROUNDED, added_prices
from placement_env.checks import check_whole
from placement_env.envs.maps.terms import Terms
from placement_env.rl.maps.link_check import sent_when_empty
from placement_env.rl.maps.map_network import LEAST_EVIDENCE, MapNetwork
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.runtime.files import write_bytes
from toolkit.runtime.json_files import parse_json
from toolkit.sites.site import Site

SHIPPED_POLICY = Path(__file__).parent / "map_policy.safetensors"
FORMAT_OF_POLICY = "coview MapNetwork 1"
LEVELS = np.linspace(np.log(LEAST_EVIDENCE), 25.0, 8192)  # of log evidence, at which hits are tabled
NO_ROOM = 1e-9  # kbit that are left at least of a link, so that there is a logarithm
PREDICTED_AT_ONCE = 4096  # candidates that the network looks at together
SWAPS = 2  # times that every sensor is reconsidered


@dataclass(frozen=True)
class MapAnswer:
    """members: of the set, ascending; ap: that the network predicts of it; seconds: that it took, NaN if not timed."""

    members: tuple[int, ...]
    ap: float
    seconds: float = math.nan


class MapPolicy:
    """Answers by a network. source: what it was taught, in words."""

    def __init__(self, network: MapNetwork, source: str = "") -> None:
        self.network, self.source = network.eval(), source
        with torch.no_grad():
            hits = network.hit(torch.exp(torch.from_numpy(LEVELS)).float())
        self._hits = hits.numpy().astype(np.float32)
        self._false_alarms = float(torch.sigmoid(network.false_alarms.detach()))

    def answer(
        self,
        site: Site,
        candidates: Candidates,
        budget: int,
        *,
        terms: Terms | None = None,
        swaps: int = SWAPS,
    ) -> MapAnswer:
        """At most `budget` of the candidates; terms: prices, money, failures and weights, None for the candidates'
        own, any money, AP alone. Raises ValueError for a budget below 1 or terms of other candidates."""
        check_whole("budget", budget, least=1)
        terms = replace(terms, budget=budget) if terms else Terms.plain(candidates, budget)
        return self.answer_to(outlook(site, candidates), terms, swaps=swaps)

    def proposal(self, site: Site, terms: Terms, *, look: bool = True) -> MapAnswer:
        """An answer on terms, with the seconds that it took; look: at the empty site from the chosen sensors, so that
        their links are known to carry what they send."""
        begun = time.perf_counter()
        known = outlook(site, terms.candidates)
        if look:
            answer = self.answer_checked(known, terms, sent_when_empty(site, terms.candidates))
        else:
            answer = self.answer_to(known, terms)
        return replace(answer, seconds=time.perf_counter() - begun)

    def answer_checked(
        self,
        known: Outlook,
        terms: Terms,
        sends: Callable[[tuple[int, ...]], Float64[np.ndarray, " k"]],
        *,
        swaps: int = SWAPS,
    ) -> MapAnswer:
        """An answer whose links carry what its sensors send. sends: asked of the members of an answer, once of each and
        of no other candidate, how many kbit they send in a frame; with that it answers again, until it knows all of its
        members."""
        sent = np.full(len(terms.candidates), np.nan)
        while True:
            answer = self.answer_to(known, terms, swaps=swaps, sent=sent)
            fresh = tuple(member for member in answer.members if np.isnan(sent[member]))
            if not fresh:
                return answer
            sent[list(fresh)] = sends(fresh)

    def answer_to(
        self,
        known: Outlook,
        terms: Terms,
        *,
        swaps: int = SWAPS,
        sent: Float64[np.ndarray, " C"] | None = None,
    ) -> MapAnswer:
        """An answer where the outlook is known already. sent: kbit of a frame by each candidate as far as that is
        known, NaN where the network has to guess it. Raises ValueError for terms of other candidates."""
        if len(terms.candidates) != len(known.view):
            raise ValueError(f"terms are of {len(terms.candidates)} candidates, the outlook of {len(known.view)}")
        predicted = self.predicted(known)
        return (predicted if sent is None else replace(predicted, sent=sent)).answer(terms, swaps=swaps)

    def shortlist(self, known: Outlook, terms: Terms, count: int) -> Int64[np.ndarray, " count"]:
        """The `count` candidates that are predicted to add most, alone or to a prefix of the answer, ascending: what a
        search that looks for itself may be confined to."""
        predicted, chosen = self.predicted(known), list(self.answer_to(known, terms, swaps=0).members)
        rank = np.full(len(known.view), len(known.view))
        for taken in range(len(chosen) + 1):
            order = np.argsort(-predicted.gains(chosen[:taken], terms), kind="stable")
            rank[order] = np.minimum(rank[order], np.arange(len(order)))
        rank[chosen] = -1
        return np.sort(np.argsort(rank, kind="stable")[:count])

    def predicted(self, known: Outlook) -> Predicted:
        """What the network makes of candidates once for all sets."""
        channels = torch.from_numpy(known.plan.channels[known.plan.used])
        view, features = torch.from_numpy(known.view), torch.from_numpy(known.features)
        with torch.no_grad():
            blocks = (torch.split(each, PREDICTED_AT_ONCE) for each in (view, features))
            parts = [self.network.prospects(channels, *part) for part in zip(*blocks, strict=True)]
        evidence, log_kbit, log_spread = (
            torch.cat([getattr(part, name) for part in parts]).numpy()
            for name in ("evidence", "log_kbit", "log_spread")
        )
        weight = parts[0].weight.numpy()
        unknown = np.full(len(log_kbit), np.nan)
        return Predicted(evidence, weight, log_kbit, log_spread, self._hits, self._false_alarms, unknown)

    def save(self, path: str | Path) -> None:
        """Write a safetensors file, whole or not at all. Raises ValueError where a weight is not finite."""
        from safetensors.torch import save

        tensors = {name: tensor.detach().contiguous() for name, tensor in self.network.state_dict().items()}
        check_tensors(tensors, tensors, path)
        metadata = {
            "format": FORMAT_OF_POLICY, "width": str(self.network.width), "digest": digest_of(tensors),
            "source": json.dumps(self.source),
        }  # fmt: skip
        write_bytes(path, header_in_order(save(tensors, metadata)))

    @staticmethod
    def load(path: str | Path = SHIPPED_POLICY) -> MapPolicy:
        """The policy of a file, the shipped one where none is named. Raises FileNotFoundError; ValueError, in one line,
        where the file is damaged or of another kind."""
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no policy at {path}: see train_map_policy")
        metadata, tensors = read_tensors(path, FORMAT_OF_POLICY)
        network = MapNetwork(len(tensors["of_view.bias"]))
        check_tensors(network.state_dict(), tensors, path)
        network.load_state_dict(tensors)
        return MapPolicy(network, str(parse_json(metadata.get("source", '""'))))


@dataclass(frozen=True, eq=False)
class Predicted:
    """`Prospects` as arrays, with which sets are valued quickly: a vehicle's chance to be hit is looked up. sent: kbit
    of a frame by each candidate where that is known, NaN where it is guessed."""

    evidence: Float32[np.ndarray, "C Q"]
    weight: Float32[np.ndarray, " Q"]
    log_kbit: Float32[np.ndarray, " C"]
    log_spread: Float32[np.ndarray, " C"]
    hits: Float32[np.ndarray, " levels"]
    false_alarms: float
    sent: Float64[np.ndarray, " C"]

    def ap(self, evidence: Float32[np.ndarray, "*n Q"]) -> Float32[np.ndarray, "*n"]:
        """AP by the evidence of each cell."""
        level = (np.log(evidence + np.float32(LEAST_EVIDENCE)) - LEVELS[0]) / (LEVELS[1] - LEVELS[0])
        value = self.hits[np.clip(level, 0, len(LEVELS) - 1).astype(np.int32)] @ self.weight
        return np.asarray(value * (1 - self.false_alarms * (1 - value)))

    def ap_of(self, chosen: Sequence[int]) -> float:
        """AP of a set; 0 of none."""
        return float(self.ap(self._sum(chosen))) if len(chosen) else 0.0

    @cached_property
    def kbit(self) -> Float64[np.ndarray, " C"]:
        """What each candidate sends in a frame, its expected value where that is guessed."""
        guessed = np.exp(self.log_kbit.astype(np.float64) + np.exp(2 * self.log_spread) / 2)
        return np.where(np.isnan(self.sent), guessed, self.sent)

    def gains(self, chosen: Sequence[int], terms: Terms) -> Float64[np.ndarray, " C"]:
        """What each candidate adds to the reward of a set, as far as its link is likely to carry it."""
        weights, candidates = terms.weights, terms.candidates
        sent = float(self.kbit[list(chosen)].sum())
        before = self.ap_of(chosen) - weights.comm * sent / max(1, len(chosen))
        after = self.ap(self._sum(chosen) + self.evidence) - weights.comm * (sent + self.kbit) / (len(chosen) + 1)
        price = added_prices(candidates, terms.row(chosen))
        return self.carried(candidates, chosen) * (after - before - weights.price * price)

    def carried(self, candidates: Candidates, chosen: Sequence[int] = ()) -> Float64[np.ndarray, " C"]:
        """How likely the link of each candidate carries what it sends beside what members of a set send over it: 0 or
        1 where that is known."""
        from scipy.special import ndtr

        members = list(chosen)
        count = len(candidates.mounts)
        load = np.bincount(candidates.mount[members], self.kbit[members], minlength=count)[candidates.mount]
        room = np.maximum(candidates.capacity - load, NO_ROOM)
        guessed = ndtr((np.log(room) - self.log_kbit) / np.exp(self.log_spread))
        rounded = np.where(load > 0, ROUNDED, 0.0)  # as feasible sets may exceed a shared link
        known = load + self.sent <= candidates.capacity * (1 + rounded)
        return np.where(np.isnan(self.sent), guessed, known).astype(np.float64)

    def answer(self, terms: Terms, *, swaps: int = SWAPS) -> MapAnswer:
        """The set that is chosen on terms."""
        chosen: list[int] = []
        while len(chosen) < terms.budget and (best := self.best(chosen, terms)) is not None:
            chosen.append(best)
        for place in list(range(len(chosen))) * swaps:
            others = chosen[:place] + chosen[place + 1 :]
            best = self.best(others, terms)
            chosen = chosen if best is None else [*chosen[:place], best, *chosen[place + 1 :]]
        return MapAnswer(tuple(sorted(chosen)), self.ap_of(chosen))

    def best(self, chosen: Sequence[int], terms: Terms) -> int | None:
        """The candidate that adds most, None where none may join or none adds anything."""
        allowed: Bool[np.ndarray, " C"] = terms.allowed(chosen)
        gains = np.where(allowed, self.gains(chosen, terms), -np.inf)
        best = int(gains.argmax())
        return best if gains[best] > 0 else None

    def _sum(self, chosen: Sequence[int]) -> Float32[np.ndarray, " Q"]:
        return np.asarray(self.evidence[list(chosen)].sum(axis=0))
