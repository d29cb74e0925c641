"""Mutations of certificates at random, with the digest and without it: python benchmarks/mutations.py [COUNT] [SEED]

Most are of small random certificates of one to four states, by cells or by cases; the others are of the shipped ones,
of which most are cut to few of their sets. `--first` continues where another run ended. Every claim that the checker
calls proven without the digest is asked of an oracle that shares no code with it (tests/certificates.py): the exact
engine, `prove_error`, brute force in fractions, random steps. Prints a table by kind of mutation; the exit status is 1
if the oracle disagrees once, or a change that changes the content passes the digest.
"""

import argparse
import json
import sys
import warnings
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

from mireach.certificate import checker
from mireach.engines import exact

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from certificates import CASE_MUTATIONS, MUTATIONS, false_claims, outcome, random_certificate  # noqa: E402

SMALL = 60  # random certificates of each size and kind of proof
SIZES = (1, 2, 2, 2, 3, 3, 4)  # numbers of states
SHIPPED = ("pwa", "double_integrator", "three_tanks", "four_tanks", "aircraft_pitch", "quadrotor")
SHARES = (0.5, 0.1, 0.1, 0.2, 0.05, 0.05)  # of mutations of shipped certificates; some take an oracle seconds
MOST_SETS = {"double_integrator": 5, "three_tanks": 5, "four_tanks": 8, "aircraft_pitch": 3, "quadrotor": 2}
EVERY = {**MUTATIONS, **CASE_MUTATIONS}
COLUMNS = ("refused", "named", "same content", "refuted", "not checked", "accepted", "DISAGREEMENT")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("count", type=int, nargs="?", default=2000)
    parser.add_argument("seed", type=int, nargs="?", default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutation; default: 0")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    table, confirmed = {kind: Counter() for kind in EVERY}, 0
    for number in range(options.first, options.first + options.count):
        rng = np.random.default_rng([options.seed, number])
        kind = list(EVERY)[number % len(EVERY)]
        text = original(rng, by_cases=kind in CASE_MUTATIONS)
        try:
            found, proven = judge(text, EVERY[kind](text, rng))
        except Exception as error:
            print(f"{number}, {kind}: {type(error).__name__}: {error}", file=sys.stderr)
            found, proven = ["DISAGREEMENT"], 0
        if "DISAGREEMENT" in found:
            print(f"DISAGREEMENT: number {number}, {kind}", file=sys.stderr)
        table[kind].update(found)
        confirmed += proven
    print(f"| mutation | {' | '.join(COLUMNS)} |\n| --- |{' ---: |' * len(COLUMNS)}")
    total = sum(table.values(), Counter())
    for kind, row in [*table.items(), ("all", total)]:
        print(f"| {kind} | {' | '.join(str(row[column]) for column in COLUMNS)} |")
    print(
        f"\n{options.count} mutations, seed {options.seed}; {confirmed} claims called proven were asked of the oracle"
    )
    return 1 if total["DISAGREEMENT"] else 0


def original(rng, by_cases):
    """The text of a certificate."""
    if rng.random() < 0.9:
        proof = "cases" if by_cases or rng.random() < 0.3 else "cells"
        return random_certificate(int(rng.integers(SMALL)), int(rng.choice(SIZES)), proof)
    return shipped("quadrotor" if by_cases else str(rng.choice(SHIPPED, p=SHARES)))


@cache
def shipped(name):
    """A shipped certificate with the first of its sets, the last of which need not be RPI."""
    content = json.loads((ROOT / "data" / name / "certificate.json").read_text())
    most = MOST_SETS.get(name)
    if most is None:
        return json.dumps(content)
    content["sets"] = content["sets"][:most]
    content["claims"]["terminal_set"]["steps"] = most - 1
    if "cases" in content:
        images = content["cases"]["images"]
        content["cases"]["images"] = [image for image in images if max(image["from"], image["to"]) < most]
    claims, h = content["claims"], np.array(content["sets"])
    alpha = exact.growth(np.array(content["template"]), h[-2], h[-1], claims["theorem_1"]["centre"])
    claims["theorem_1"] |= {"alpha": None if alpha is None else str(alpha), "stable": alpha is not None and alpha > 1}
    if checker.check(checker.parse(json.dumps(content)))["criterion"].verdict == "refuted":
        claims["criterion"]["holds"] = not claims["criterion"]["holds"]
    content["digest"] = checker.digest(checker.parse(json.dumps(content)))
    return json.dumps(content)


def judge(text, changed):
    """What became of a mutation: words of `COLUMNS`; and how many claims the oracle was asked about."""
    found = []
    verdict, _ = outcome(changed, ignore_digest=False)
    if verdict in ("refused", "named"):
        found.append(verdict)
    else:
        same = checker.digest(checker.parse(changed)) == checker.digest(checker.parse(text))
        found.append("same content" if same else "DISAGREEMENT")
    verdict, report = outcome(changed)
    if report is None:
        return found, 0
    proven = sum(result.verdict == "proven" for result in report.results)
    return [*found, "DISAGREEMENT" if false_claims(changed, report) else verdict], proven


if __name__ == "__main__":
    sys.exit(main())
