"""All engines on many random loops: python benchmarks/fuzz.py [COUNT] [FIRST] [--states N | --hard]

Prints the questions asked and every disagreement; the exit status is 1 if there is one. With --states 3 the loops have
three states instead of two, and three sets each, one of which the MILP is asked about. With --hard the loops are badly
conditioned and the truth is found in fractions. The questions, and what counts as a disagreement, are in
tests/fuzz.py.
"""

import argparse
import sys
from collections import Counter
from functools import partial
from pathlib import Path

from joblib import Parallel, delayed
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from fuzz import disagreements, wrong_verdicts


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("count", type=int, nargs="?", default=5000, help="loops; default: 5000")
    parser.add_argument("first", type=int, nargs="?", default=1000, help="the first seed; default: 1000")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--states", type=int, default=2, help="of each loop; default: 2")
    kind.add_argument("--hard", action="store_true", help="badly conditioned loops")
    options = parser.parse_args()
    ask = wrong_verdicts if options.hard else disagreements
    if options.states != 2:
        ask = partial(disagreements, milp_sets=1, n=options.states, most_sets=3)
    count, first = options.count, options.first
    work = Parallel(n_jobs=-1, return_as="generator")(delayed(ask)(first + i) for i in range(count))
    asked, found = Counter(loops=count), []
    for texts, questions in tqdm(work, total=count, unit="loop"):
        asked += questions
        found += texts
    for name, number in asked.items():
        print(f"{name}: {number}")
    print(f"disagreements: {len(found)}")
    print("\n".join(found))
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
