"""Mutations of certificates at random, with the digest and without it: python benchmarks/mutations.py [COUNT] [SEED]

Three of four are of small random certificates, the others of the shipped ones. Every claim that the checker calls
proven without the digest is asked of an oracle that shares no code with it (tests/certificates.py): the exact engine,
`prove_error`, brute force in fractions, random steps. Prints a table by kind of mutation; the exit status is 1 if the
oracle disagrees once, or a change that changes the content passes the digest.
"""

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from mireach.certificate import checker

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from certificates import MUTATIONS, false_claims, outcome, random_certificate  # noqa: E402

SMALL = 60  # random certificates
SHIPPED = ("pwa", "pwa", "pwa", "double_integrator")  # the second takes an oracle seconds
COLUMNS = ("refused", "named", "same content", "refuted", "not checked", "accepted", "DISAGREEMENT")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("count", type=int, nargs="?", default=2000)
    parser.add_argument("seed", type=int, nargs="?", default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    table, confirmed = {kind: Counter() for kind in MUTATIONS}, 0
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        kind, text = list(MUTATIONS)[number % len(MUTATIONS)], original(rng)
        try:
            found, proven = judge(text, MUTATIONS[kind](text, rng))
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


def original(rng):
    """The text of a certificate."""
    if rng.random() < 0.75:
        return random_certificate(int(rng.integers(SMALL)))
    return (ROOT / "data" / rng.choice(SHIPPED) / "certificate.json").read_text()


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
