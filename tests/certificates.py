"""Small random certificates, mutations of their text, and an oracle of claims that shares no code with the checker.

The oracle reads the text itself, every number as the float that it is, lists corners by brute force in fractions,
replays random steps in fractions, and asks the exact engine and `prove_error` about a loop that it builds from the
floats of the text. It does not look at proofs by cases: what they prove has to be true.
"""

import json
import re
import warnings
from dataclasses import replace
from fractions import Fraction
from functools import cache, cached_property, lru_cache, wraps
from itertools import combinations, pairwise, product
from math import comb, gcd, lcm
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
from loops import enclosing_inputs, exact_input, random_loop

import mireach as mr
from mireach.arithmetic.rational import maximize, rational
from mireach.certificate import checker, make
from mireach.certificate.cases import CaseProver
from mireach.engines import exact_cells
from mireach.errors import CellLimitError
from mireach.systems import partition

SAMPLES = 3  # corners, and random states, that are replayed for one image
SMALLEST, LARGEST = Fraction("1e-300"), 10**15  # beyond these the engines' floats are of no use: fractions alone judge
UNDECIDED = 1e-11  # a criterion closer to equality than this is not judged by the oracle's floats
ERROR = 1e-9  # by which `prove_error` ends its search, and bounds of other engines than the exact one may be off
MOST_CHOICES = 20_000  # of n rows, all of which brute force tries

# -- builders -----------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def random_certificate(seed, n=2, proof=None):
    """The text of a small certificate: regions of x or of (x, u), jumps, D by mode, sometimes a plant."""
    rng = np.random.default_rng(seed)
    with_plant = seed % 4 == 3
    cuts, layers = 0 if with_plant else int(rng.integers(1, 3)), int(rng.integers(1, 3 if n < 4 else 2))
    pool = int(rng.choice([1, 2, 3])) if n != 2 or proof else 2
    loop = random_loop(seed, n, cuts=cuts, with_input=seed % 2 == 1, layers=layers, pool=pool, saturated=seed % 6 == 2)
    plant = None
    if with_plant:
        loop, plant = near_polynomial(loop)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(8):
            loop = contracted(loop, 0.6)
            safe = mr.safe_set(loop, template(rng, int(rng.integers(4, 9)), n))
            if safe.set is not None and safe.set.support(mr.box_directions(n)).max() < 10:
                break
        if plant is not None:  # of the loop as it is now
            plant = mr.NonlinearSystem(polynomial(loop.system.modes[0]), plant.state_set, plant.input_set)
        terminal = mr.terminal_set(loop, safe, template(rng, 4, n), 0.05, max_steps=5) if seed % 5 else None
        return json.dumps(make(loop, safe, terminal, plant=plant, proof=proof).content)


def template(rng, count, n):
    """Directions that bound sets: `count` of them in the plane, else those of boxes and up to two more."""
    if n == 2:
        return mr.directions(count)
    return np.vstack([mr.box_directions(n), rng.normal(size=(count % 3, n))])


def contracted(loop, factor):
    """The loop with smaller A, B and p."""
    modes = [replace(mode, A=factor * mode.A, B=factor * mode.B, p=factor * mode.p) for mode in loop.system.modes]
    return mr.ClosedLoop(replace(loop.system, modes=modes), loop.network)


def near_polynomial(loop):
    """The loop with a D that holds the error of `polynomial`, and a plant."""
    U = loop.system.input_set
    reach = 0.01 * max(np.abs(loop.system.state_set.h)) ** 2 + 0.002 * max(np.abs(U.h)) + 0.01
    n = loop.system.state_size
    loop = loop.with_disturbance(mr.Polytope.box([-reach] * n, [reach] * n))
    return loop, mr.NonlinearSystem(lambda x, u: x, loop.system.state_set, U)


def polynomial(mode):
    """f that is a mode's map and a little more."""
    A, B, p = mode.A.tolist(), mode.B.tolist(), mode.p.tolist()

    def f(x, u):
        more = (0.01 * x[0] * x[-1], 0.01 * x[-1] ** 2 - 0.002 * u[0])
        return [
            sum((e * v for e, v in zip(a, x)), b[0] * u[0] + c) + more[i % 2]
            for i, (a, b, c) in enumerate(zip(A, B, p))
        ]

    return f


# -- mutations ----------------------------------------------------------------------------------------

STRANGE = (None, True, "", [], {}, -1, 1e300, "x")


def nodes(value, path=()):
    """The paths of all nodes of a JSON tree, the root left out."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*path, key)
        yield from nodes(value[key], (*path, key))


def get(content, path):
    for key in path:
        content = content[key]
    return content


def put(content, path, value):
    get(content, path[:-1])[path[-1]] = value


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def pick(content, rng, wanted):
    """A random path whose value is wanted; None if there is none."""
    paths = [path for path in nodes(content) if wanted(get(content, path))]
    return paths[rng.integers(len(paths))] if paths else None


def change_digit(text, rng):
    places = [i for i, letter in enumerate(text) if letter.isdigit()]
    i = places[rng.integers(len(places))]
    return text[:i] + str((int(text[i]) + rng.integers(1, 10)) % 10) + text[i + 1 :]


def cut_off(text, rng):
    return text[: rng.integers(len(text))]


def double_key(text, rng):
    places = [i for i, letter in enumerate(text) if letter == "{"]
    i = places[rng.integers(len(places))] + 1
    key = text[i:].split(":")[0]
    return f"{text[:i]}{key}: null, {text[i:]}"


def of_tree(change):
    """A mutation of the tree as one of the text."""

    def mutate(text, rng):
        content = json.loads(text)
        return json.dumps(change(content, rng) or content)

    return mutate


def change_sign(content, rng):
    path = pick(content, rng, lambda value: is_number(value) and value)
    put(content, path, -get(content, path))


def change_slightly(content, rng):
    """Anything between one ulp and a factor of two."""
    path = pick(content, rng, lambda value: isinstance(value, float) and value)
    value = get(content, path)
    share = 10.0 ** -rng.integers(1, 17) * rng.choice([-1, 1])
    put(content, path, value * (1 + share) if rng.random() < 0.8 else float(np.nextafter(value, 9 * rng.normal())))


def move_set(content, rng):
    """The offsets of one set, or of all, a little larger or smaller."""
    sets = content["sets"]
    chosen = range(len(sets)) if rng.random() < 0.5 else [rng.integers(len(sets))]
    size = 10.0 ** -rng.integers(1, 13) * rng.choice([-1, 1])
    for k in chosen:
        sets[k] = [offset + size for offset in sets[k]]


def move_one_offset(content, rng):
    row = content["sets"][rng.integers(len(content["sets"]))]
    row[rng.integers(len(row))] += 10.0 ** -rng.integers(0, 14) * rng.choice([-1, 1])


def change_plant_slightly(content, rng):
    """An entry of A, B, p, D, X or U moved by few digits."""
    path = pick(content["system"], rng, is_number)
    value = get(content["system"], path)
    put(content["system"], path, round(value + 10.0 ** -rng.integers(0, 10) * rng.choice([-1, 1]), 12))


def change_network_slightly(content, rng):
    path = pick(content["network"], rng, lambda value: isinstance(value, float))
    put(content["network"], path, get(content["network"], path) + 10.0 ** -rng.integers(0, 14) * rng.choice([-1, 1]))


def swap_entries(content, rng):
    path = pick(content, rng, lambda value: isinstance(value, list) and len(value) > 1)
    value = get(content, path)
    i, j = rng.choice(len(value), 2, replace=False)
    value[i], value[j] = value[j], value[i]


def swap_sets(content, rng):
    sets = content["sets"]
    i, j = rng.integers(len(sets), size=2)
    sets[i], sets[j] = sets[j], sets[i]


def copy_set(content, rng):
    sets = content["sets"]
    i, j = rng.integers(len(sets), size=2)
    sets[i] = list(sets[j])


def swap_layers(content, rng):
    hidden = content["network"]["hidden"]
    i, j = rng.integers(len(hidden), size=2)
    hidden[i], hidden[j] = hidden[j], hidden[i]


def other_network(content, rng):
    """Every weight drawn anew."""
    for path in list(nodes(content["network"])):
        if isinstance(get(content["network"], path), float):
            put(content["network"], path, float(0.5 * rng.normal()))


def delete(content, rng):
    paths = list(nodes(content))
    path = paths[rng.integers(len(paths))]
    del get(content, path[:-1])[path[-1]]


def delete_claim(content, rng):
    del content["claims"][rng.choice(list(content["claims"]))]


def delete_set(content, rng):
    """One set less, and one step less, as a careful forger would."""
    if len(content["sets"]) > 2:
        del content["sets"][rng.integers(len(content["sets"]))]
        content["claims"]["terminal_set"]["steps"] -= 1


def double_entry(content, rng):
    path = pick(content, rng, lambda value: isinstance(value, list) and value)
    value = get(content, path)
    value.insert(rng.integers(len(value) + 1), value[rng.integers(len(value))])


def add_key(content, rng):
    path = pick(content, rng, lambda value: isinstance(value, dict))
    get(content, path)[str(rng.choice(["reason", "witness", "bounds", "plant", "digest", "more"]))] = None


def flip(content, rng):
    path = pick(content, rng, lambda value: isinstance(value, bool))
    if path is None:
        return change_verdict(content, rng)
    return put(content, path, not get(content, path))


def change_verdict(content, rng):
    content["claims"][rng.choice(list(content["claims"]))]["verdict"] = str(
        rng.choice(["proven", "bounded", "not proven", "true"])
    )


def change_alpha(content, rng):
    claim = content["claims"].get("theorem_1", {"alpha": None})
    alpha = Fraction(claim["alpha"] or 1)
    claim["alpha"] = str(
        rng.choice([alpha + Fraction(1, 10**30), -alpha, 1 / alpha, "1/0", "1/00", "nan", f"{alpha}0"])
    )
    claim["stable"] = bool(rng.integers(2))


def change_centre(content, rng):
    for name in ("criterion", "theorem_1"):
        if name in content["claims"]:
            content["claims"][name]["centre"] = (
                (rng.normal(size=len(content["template"][0])) * rng.choice([0.1, 3])).round(3).tolist()
            )


def change_epsilon(content, rng):
    if "criterion" in content["claims"]:
        content["claims"]["criterion"]["epsilon"] = float(rng.choice([1e-9, 0.5, 10.0, 0.0, -1.0]))


def change_version(content, rng):
    place = content if rng.random() < 0.5 else content["network"]
    place["format"] = str(rng.choice(["mireach-certificate/2", "mireach-network/1", "mireach-certificate/1", ""]))


def change_type(content, rng):
    paths = list(nodes(content))
    put(content, paths[rng.integers(len(paths))], STRANGE[rng.integers(len(STRANGE))])


def huge_number(text, rng):
    """A number with an exponent that ends in nothing or in everything."""
    content, mark = json.loads(text), "12345e54321"
    put(content, pick(content, rng, is_number), mark)
    exponent = rng.choice(["e999", "e-999", "e99999999", "e300", "e-300", "9" * 60])
    return json.dumps(content).replace(f'"{mark}"', f"{rng.choice(['', '-'])}1{exponent}")


def huge_list(content, rng):
    path = pick(content, rng, lambda value: isinstance(value, list) and value)
    put(content, path, get(content, path) * int(rng.choice([2, 50, 3000])))


def write_otherwise(text, rng):
    """The same content: keys in another order, other white space, more zeros."""

    def turned(value):
        if isinstance(value, dict):
            return {key: turned(value[key]) for key in reversed(value)}
        return [turned(entry) for entry in value] if isinstance(value, list) else value

    return re.sub(r"(?<=[ -])0\.0(?=[,\s])", "0.000e2", json.dumps(turned(json.loads(text)), indent=1))


def move_inputs(content, rng):
    """The offsets of U a little larger or smaller."""
    U = content["system"]["input_set"]
    U["h"] = [offset + float(rng.choice([-1.0, -1e-3, -1e-12, 1e-3])) for offset in U["h"]]


def open_gap(content, rng):
    """An offset of a region a little smaller, which leaves a gap, or larger, where both modes act then."""
    h = content["system"]["modes"][rng.integers(len(content["system"]["modes"]))]["region"]["h"]
    h[rng.integers(len(h))] -= float(rng.choice([1e-12, 1e-3, 0.1, -0.1]))


def enlarge_disturbance(content, rng):
    D = content["system"]["modes"][rng.integers(len(content["system"]["modes"]))]["disturbance"]
    D["h"] = [h + float(rng.choice([1e-13, 1e-3, 0.1])) for h in D["h"]]


def flatten(content, rng):
    """A set without an extent along a row of the template and its opposite, if there is one."""
    C, h = content["template"], content["sets"][rng.integers(len(content["sets"]))]
    i = int(rng.integers(len(C)))
    opposite = [-entry for entry in C[i]]
    if opposite in C:
        h[C.index(opposite)] = -h[i]


def one_ulp(content, rng):
    """An offset of a set one float smaller."""
    h = content["sets"][rng.integers(len(content["sets"]))]
    i = rng.integers(len(h))
    h[i] = float(np.nextafter(h[i], -np.inf))


MUTATIONS = {
    "a digit": change_digit,
    "a sign": of_tree(change_sign),
    "a number, slightly": of_tree(change_slightly),
    "a set moved": of_tree(move_set),
    "an offset moved": of_tree(move_one_offset),
    "the plant, slightly": of_tree(change_plant_slightly),
    "the network, slightly": of_tree(change_network_slightly),
    "two entries swapped": of_tree(swap_entries),
    "two sets swapped": of_tree(swap_sets),
    "a set copied": of_tree(copy_set),
    "two layers swapped": of_tree(swap_layers),
    "another network": of_tree(other_network),
    "an entry deleted": of_tree(delete),
    "a claim deleted": of_tree(delete_claim),
    "a set deleted": of_tree(delete_set),
    "an entry doubled": of_tree(double_entry),
    "a key added": of_tree(add_key),
    "a key doubled": double_key,
    "a truth flipped": of_tree(flip),
    "a verdict": of_tree(change_verdict),
    "alpha": of_tree(change_alpha),
    "the centre": of_tree(change_centre),
    "epsilon": of_tree(change_epsilon),
    "the version": of_tree(change_version),
    "U moved": of_tree(move_inputs),
    "a gap or an overlap": of_tree(open_gap),
    "a larger D": of_tree(enlarge_disturbance),
    "a flat set": of_tree(flatten),
    "an offset, one float": of_tree(one_ulp),
    "a type": of_tree(change_type),
    "a huge number": huge_number,
    "a huge list": of_tree(huge_list),
    "cut off": cut_off,
    "written otherwise": write_otherwise,
}

# -- mutations of proofs by cases -----------------------------------------------------------------------

LIE = (move_set, move_one_offset, change_plant_slightly, move_inputs, enlarge_disturbance, one_ulp, swap_sets, flip)


def trees_of(content):
    """All trees, those of the inputs and of the images."""
    cases = content["cases"]
    return [*cases["inputs"], *(tree for image in cases["images"] for tree in image["rows"])]


def any_tree(content, rng):
    """A tree with nodes; an empty list if there is none."""
    trees = [tree for tree in trees_of(content) if tree] or [[]]
    return trees[rng.integers(len(trees))]


def any_node(content, rng, wanted=lambda node: node):
    """A node that is wanted; a new one that belongs to no tree if there is none."""
    found = [node for tree in trees_of(content) for node in tree if wanted(node)] or [[1]]
    return found[rng.integers(len(found))]


def change_entry(content, rng):
    """A weight, a number of a limit, a layer or a neuron."""
    node = any_node(content, rng)
    i = rng.integers(len(node))
    node[i] = [node[i] + 1, max(node[i] - 1, 0), 0, 1, 2 * node[i], 10**30, 1e300, -1, -node[i], 0.5][rng.integers(10)]


def change_weights(content, rng):
    """All weights of a node in another proportion, or the weight of the form none."""
    node = any_node(content, rng, lambda node: len(node) % 2)
    node[0] = int(rng.choice([0, 1, 10**6]))
    for i in range(2, len(node), 2):
        node[i] *= int(rng.choice([1, 2, 10**9]))


def change_limits(content, rng):
    """The numbers of the limits of a node, some of them beyond those that there are."""
    node = any_node(content, rng, lambda node: len(node) > 2 and len(node) % 2)
    for i in range(1, len(node), 2):
        node[i] = int(rng.choice([node[i], node[i] + 1, 0, 10**6, 1e300 if rng.random() < 0.1 else 5]))


def erase_node(content, rng):
    tree = any_tree(content, rng)
    if tree:
        del tree[rng.integers(len(tree))]


def add_node(content, rng):
    """A node from elsewhere, or one that says nothing."""
    node = [list(any_node(content, rng)), [], [1], [0], [0, 0, 1]][rng.integers(5)]
    tree = any_tree(content, rng)
    tree.insert(rng.integers(len(tree) + 1), node)


def swap_nodes(content, rng):
    tree = any_tree(content, rng)
    if tree:
        i, j = rng.integers(len(tree), size=2)
        tree[i], tree[j] = tree[j], tree[i]


def split_elsewhere(content, rng):
    """A split of another neuron, of one that there is not, of one that is split already, or a leaf that was a split."""
    node = any_node(content, rng, lambda node: len(node) == 2)
    other = any_node(content, rng, lambda node: len(node) == 2)
    node[:] = [[0, 0], [1, 0], [0, 1], [99, 0], [0, 10**6], [0, 1e300], other, [1]][rng.integers(8)]


def split_more(content, rng):
    """A leaf behind a split, whose other leaves are those that come next, or copies of it."""
    tree = any_tree(content, rng)
    if tree:
        i = rng.integers(len(tree))
        copies = [list(tree[i]) for _ in range(int(rng.integers(0, 3)))]
        tree[i:i] = [[int(rng.integers(2)), int(rng.integers(3))], *copies]


def cut_tree(content, rng):
    tree = any_tree(content, rng)
    del tree[rng.integers(len(tree) + 1) :]


def move_trees(content, rng):
    """Too many trees, too few, or in another order, in one of the images or for the inputs."""
    cases = content["cases"]
    lists = [cases["inputs"], *(image["rows"] for image in cases["images"])]
    trees = lists[rng.integers(len(lists))]
    change = rng.integers(4)
    if change == 0 and trees:
        del trees[rng.integers(len(trees))]
    elif change == 1:
        trees.append([])
    elif change == 2:
        trees.reverse()
    else:
        trees[:] = lists[rng.integers(len(lists))]


def move_image(content, rng):
    """From and to swapped, other numbers, an image that is not there or stands there twice."""
    images = content["cases"]["images"]
    if not images:
        return
    image = images[rng.integers(len(images))]
    change = rng.integers(4)
    if change == 0:
        image["from"], image["to"] = image["to"], image["from"]
    elif change == 1:
        image[str(rng.choice(["from", "to"]))] = float(rng.choice([0, 1, 2, 10**6, 1e300, -1, 0.5]))
    elif change == 2:
        images.remove(image)
    else:
        images.append({**image, "to": image["from"]})


def change_attained(content, rng):
    """A state or a mode that is named for a row, or their number."""
    attained = content["cases"]["attained"]
    if attained:
        one = attained[rng.integers(len(attained))]
        change = rng.integers(4)
        if change == 0:
            one["mode"] = float(rng.choice([0, 1, 2, 99, 1e300, -1]))
        elif change == 1:
            one["state"] = [entry + float(rng.normal()) * 10.0 ** -rng.integers(0, 12) for entry in one["state"]]
        elif change == 2:
            attained.remove(one)
        else:
            attained.reverse()


CASE_CHANGES = {
    "a number of a proof": change_entry,
    "weights": change_weights,
    "limits": change_limits,
    "a node erased": erase_node,
    "a node added": add_node,
    "two nodes swapped": swap_nodes,
    "another split": split_elsewhere,
    "one more split": split_more,
    "a tree cut off": cut_tree,
    "trees moved": move_trees,
    "an image moved": move_image,
    "attained states": change_attained,
}


def forged(change):
    """Something false, and a proof by cases that is changed up to four times in a way, or in any."""

    def forge(content, rng):
        if rng.random() < 0.6:
            LIE[rng.integers(len(LIE))](content, rng)
        for _ in range(rng.integers(1, 5)):
            change(content, rng)
            if rng.random() < 0.2:
                list(CASE_CHANGES.values())[rng.integers(len(CASE_CHANGES))](content, rng)

    return forge


CASE_MUTATIONS = {kind: of_tree(forged(change)) for kind, change in CASE_CHANGES.items()}

OUTCOMES = ("refused", "refuted", "not checked", "accepted")


def outcome(text, ignore_digest=True, seconds=60):
    """One of `OUTCOMES`, or "named" where the digest does, and the checker's Report (None if refused)."""
    try:
        report = checker.check(checker.parse(text), ignore_digest=ignore_digest, seconds=seconds)
    except checker.Malformed:
        return "refused", None
    if not ignore_digest and report.digest != "as written":
        assert not report.proven
        return "named", report
    verdicts = {result.verdict for result in report.results}
    return next((verdict for verdict in ("refuted", "not checked") if verdict in verdicts), "accepted"), report


# -- the oracle ---------------------------------------------------------------------------------------


def false_claims(text, report):
    """The names of claims that the report calls proven and the oracle does not confirm."""
    proven = [result.claim for result in report.results if result.verdict == "proven"]
    oracle = Oracle(json.loads(text, parse_int=number, parse_float=number)) if proven else None
    return [name for name in proven if not oracle.confirms(name)]


def number(text):
    """The float that a numeral stands for, exactly."""
    return Fraction(float(text))


def dot(a, x):
    return sum(entry * value for entry, value in zip(a, x))


def holds(rows, x):
    """Whether a rational point satisfies a x <= b for every row (a, b)."""
    return all(dot(a, x) <= b for a, b in rows)


def corners_of(rows, along=None):
    """The corners of a bounded set: every point in which n rows are tight and that satisfies all rows.

    Where that would take long, and `along` is given, those that are largest along these directions, and no others.
    """
    found, own = set(), {whole_row(a, b) for a, b in rows}
    n = len(next(iter(own))) - 1
    if along is not None and comb(len(own), n) > MOST_CHOICES:
        H, h = ([rational(row[:-1]) for row in own], [rational(row[-1]) for row in own])
        points = [maximize(H, h, rational(a)).point for a in {tuple(a) for a in along}]
        return sorted({tuple(Fraction(int(e.p), int(e.q)) for e in x) for x in points if x is not None})
    for chosen in combinations(own, n):
        corner = met(chosen)
        if corner is not None:
            W, *X = corner
            if all(dot(row, X) <= row[-1] * W for row in own):
                found.add(tuple(Fraction(entry, W) for entry in X))
    return sorted(found)


def met(rows):
    """(W, X), W > 0: the one point X / W with a x = b for n rows (a, b) of whole numbers; None if it is not one."""
    M, before = [list(row) for row in rows], 1
    for i in range(len(M)):
        pivot = next((k for k in range(i, len(M)) if M[k][i]), None)
        if pivot is None:
            return None
        M[i], M[pivot] = M[pivot], M[i]
        for k in range(len(M)):
            if k != i:
                M[k] = [(M[i][i] * e - M[k][i] * f) // before for e, f in zip(M[k], M[i])]  # without a remainder
        before = M[i][i]
    sign = 1 if before > 0 else -1
    return [sign * before, *(sign * row[-1] for row in M)]


def whole_row(a, b):
    """The row a x <= b of fractions as whole numbers without a common divisor."""
    unit = lcm(*(entry.denominator for entry in (*a, b)))
    row = [int(entry * unit) for entry in (*a, b)]
    common = gcd(*row) or 1
    return tuple(entry // common for entry in row)


def growth_of(rows_before, corners, c):
    """The largest alpha >= 0 with c + alpha (x - c) in {rows_before} for all corners x; None if c is not inside."""
    shares = []
    for a, b in rows_before:
        size = max(dot(a, x) for x in corners) - dot(a, c)
        if size <= 0 or b < dot(a, c):
            return None
        shares.append((b - dot(a, c)) / size)
    return min(shares)


def rows_of(value):
    return list(zip(value["H"], value["h"]))


def floats(value):
    return np.array(value, dtype=float)


def polytope(value):
    return mr.Polytope(floats(value["H"]), floats(value["h"]))


def is_below(bounds, offsets, slack=0.0):
    """Whether floats lie below floats, or above by no more than `slack` relative to them."""
    return bool((bounds <= offsets + slack * (1 + np.abs(offsets))).all())


def remembered(method):
    """A method of sets, given by their numbers, that is not asked twice: most mutations leave most sets alone."""

    @wraps(method)
    def ask(self, *numbers):
        key = (method.__name__, self.world, *(tuple(self.sets[k]) for k in numbers))
        if key not in _ANSWERS:
            if len(_ANSWERS) > 5000:
                _ANSWERS.clear()
            _ANSWERS[key] = method(self, *numbers)
        return _ANSWERS[key]

    return ask


_ANSWERS = {}


class Oracle:
    """What is true of a content whose numbers are Fractions of floats; a method for every claim."""

    def __init__(self, content):
        self.content, self.system, self.claims = content, content["system"], content["claims"]
        self.C, self.sets = content["template"], content["sets"]
        self.n = len(self.C[0])
        for mode in self.system["modes"]:  # a mode acts where the input lies in U
            mode["region"]["H"] += [[Fraction(0)] * self.n + row for row in self.system["input_set"]["H"]]
            mode["region"]["h"] += self.system["input_set"]["h"]
        numbers = [get(self.system, path) for path in nodes(self.system)]
        numbers = [value for value in numbers if isinstance(value, Fraction)]
        self.world = repr((self.system, content["network"], self.C))
        self.beyond_floats = any(value and not SMALLEST < abs(value) < LARGEST for value in numbers)
        self.rng, self.known, self.corners = np.random.default_rng(0), {}, {}

    def confirms(self, *names):
        """Whether all of these claims are true."""
        for name in names:
            if name not in self.known:
                self.known[name] = getattr(self, name)()
        return all(self.known[name] for name in names)

    @remembered
    def inputs(self):
        """h of Phi(X) along the rows of U, from loops with x+ = (a u, 0)."""
        n, U = self.n, rows_of(self.system["input_set"])
        X = corners_of(rows_of(self.system["state_set"]), along=self._along)
        if not X or not all(holds(U, exact_input(self.network, x)) for x in self._between(X)):
            return False
        if self.beyond_floats:
            return True
        lower, upper = self.X.bounding_box()
        around = mr.Polytope.box(lower - 1, upper + 1)
        for a, b in U:
            B = np.zeros((n, len(a)))
            B[0] = floats(a)
            loop = self._loop([(np.zeros((n, n)), B, np.zeros(n), None, None)], a)
            if tops(loop, around, np.eye(n)[:1])[0] > np.nextafter(float(b), np.inf):
                return False
        return True

    def safe_set(self):
        F = self._corners(0)
        if not F or not all(holds(rows_of(self.system["state_set"]), x) for x in F):
            return False
        return self._has_successors(0) and self._contains_image(0, 0)

    def sequence(self):
        return all(self._contains_image(k, k + 1) and self._inside(k, 0) for k in range(len(self.sets) - 1))

    def terminal_set(self):
        last = len(self.sets) - 1
        own = self.claims["terminal_set"]["steps"] == last and self._inside(last, 0)
        return own and self._contains_image(last, last) and self.confirms("safe_set", "sequence")

    def criterion(self):
        claim = self.claims["criterion"]
        c, epsilon = claim["centre"], claim["epsilon"]
        if not holds(self._rows(-1), c):
            return not claim["holds"]
        h = [b - (b - dot(a, c)) * epsilon / (1 + epsilon) for a, b in self._rows(-1)]
        corners = corners_of(list(zip(self.C, h)), along=self.C)
        own = floats([max(dot(a, x) for x in corners) for a in self.C])
        if self.beyond_floats:
            return True
        margin = (tops(self.loop, mr.Polytope(floats(self.C), floats(h)), floats(self.C)) - own).min()
        return abs(margin) <= UNDECIDED or (margin > 0) == claim["holds"]

    def theorem_1(self):
        claim = self.claims["theorem_1"]
        alpha = growth_of(self._rows(-2), self._corners(-1), claim["centre"])
        stable = alpha is not None and alpha > 1
        own = claim["stable"] == stable and claim["alpha"] == (None if alpha is None else str(alpha))
        return own and (not stable or self.confirms("inputs", "terminal_set"))

    def error_set(self):
        """`prove_error`, and errors at random points."""
        if self.beyond_floats or not corners_of(rows_of(self.system["input_set"])):
            return True
        X, U = self.X, polytope(self.system["input_set"])
        components = [
            [(Fraction(t["coefficient"]), [int(power) for power in t["powers"]]) for t in f]
            for f in self.content["plant"]["f"]
        ]

        def f(x, u):
            z = [*x, *u]
            return [sum((float(c) * _power(z, powers) for c, powers in terms), 0 * z[0]) for terms in components]

        z = X.product(U).sample(self.rng, 2000)
        error = np.stack(f(z[:, : self.n].T, z[:, self.n :].T), axis=1)
        for A, B, p, region, D in self._modes:
            inside = (z @ region.H.T <= region.h - ERROR).all(axis=1)
            off = error[inside] - z[inside] @ np.hstack([A, B]).T - p
            if not is_below(off @ D.H.T, D.h, ERROR):
                return False
            try:
                proof = mr.approximation.prove_error(f, [mr.Mode(A, B, p, region, D)], X, U, D.H, max_boxes=500)
            except ValueError:  # a region without points, or so wide that no bound is finite
                continue
            if not is_below(proof.attained[0], D.h, ERROR):
                return False
        return True

    def theorem_2(self):
        return min(self.sets[-1]) > 0 and self.confirms("inputs", "terminal_set", "error_set")

    # -- parts --

    @cached_property
    def _along(self):
        """The directions that matter."""
        return [*self.C, *self.system["state_set"]["H"]]

    @cached_property
    def X(self):
        return polytope(self.system["state_set"])

    @cached_property
    def network(self):
        return mr.MaxoutNetwork.from_dict(json.loads(json.dumps(self.content["network"], default=float)))

    @cached_property
    def _modes(self):
        return [
            (*(floats(mode[name]) for name in "ABp"), polytope(mode["region"]), polytope(mode["disturbance"]))
            for mode in self.system["modes"]
        ]

    @cached_property
    def _extremes(self):
        """The corners of D of every mode."""
        return [corners_of(rows_of(mode["disturbance"])) for mode in self.system["modes"]]

    @cached_property
    def loop(self):
        return self._loop(self._modes)

    def _loop(self, modes, row=None):
        """The loop, or x+ = (row u, 0); regions may leave gaps and overlap, and U asks nothing."""
        key = self.world, repr(row)
        if key not in _LOOPS:
            m = len(modes[0][1][0])
            everywhere = mr.Polytope(np.eye(self.n + m)[:1], [1e6])
            U = mr.Polytope.box(*enclosing_inputs(self.network, mr.Polytope.box(*self.X.bounding_box())))
            if len(_LOOPS) > 20:
                _LOOPS.clear()
            with patch("mireach.systems.pwa._check_partition"):
                system = mr.PWASystem(
                    [mr.Mode(A, B, p, region or everywhere, D) for A, B, p, region, D in modes], self.X, U
                )
            _LOOPS[key] = mr.ClosedLoop(system, self.network)
        return _LOOPS[key]

    def _rows(self, k):
        return list(zip(self.C, self.sets[k]))

    def _corners(self, k):
        if k not in self.corners:
            self.corners[k] = corners_of(self._rows(k), along=self._along)
        return self.corners[k]

    def _inside(self, k, j):
        return all(holds(self._rows(j), x) for x in self._corners(k))

    def _states(self, k):
        """Some corners of R_k and random points of it, rational."""
        yield from self._between(self._corners(k))

    def _between(self, corners):
        """Some corners and random points between them, rational."""
        for i in self.rng.integers(len(corners), size=SAMPLES).tolist() if corners else ():
            yield corners[i]
        for weights in self.rng.integers(0, 50, (SAMPLES, len(corners))).tolist() if corners else ():
            if total := sum(weights):
                yield tuple(dot(weights, column) / total for column in zip(*corners))

    @remembered
    def _contains_image(self, k, j):
        """Random steps in fractions, and the exact engine."""
        for x in self._states(k):
            if holds(rows_of(self.system["state_set"]), x):
                z = [*x, *exact_input(self.network, x)]
                for mode, corners in zip(self.system["modes"], self._extremes):
                    if holds(rows_of(mode["region"]), z):
                        after = [dot([*A, *B], z) + p for A, B, p in zip(mode["A"], mode["B"], mode["p"])]
                        if not all(holds(self._rows(j), [a + e for a, e in zip(after, d)]) for d in corners):
                            return False
        if self.beyond_floats:
            return True
        C = floats(self.C)
        try:
            bound = tops(self.loop, mr.Polytope(C, floats(self.sets[k])), C)
        except ValueError:  # the engine wants at least one state on which a mode acts
            lower, upper = self.X.bounding_box()
            x = self.rng.uniform(lower, upper, (2000, self.n))
            z = np.hstack([x, self.network(x)])
            return not any((z @ region.H.T <= region.h).all(axis=1).any() for _, _, _, region, _ in self._modes)
        return is_below(bound, floats(self.sets[j]))

    @remembered
    def _has_successors(self, k):
        """No state of R_k without a region: random ones, and all of them piece by piece of Phi, in rational numbers."""
        for x in self._states(k):
            z = [*x, *exact_input(self.network, x)]
            if not any(holds(rows_of(mode["region"]), z) for mode in self.system["modes"]):
                return False
        if self.beyond_floats:
            return True
        regions = [rows_of(mode["region"]) for mode in self.system["modes"]]
        try:
            pieces = exact_cells.affine_pieces(self.network, self.X)
        except CellLimitError:  # regions that cover R_k x U do
            U = rows_of(self.system["input_set"])
            none = [Fraction(0)]
            domain = [([*a, *none * len(U[0][0])], b) for a, b in self._rows(k)]
            return not uncovered([*domain, *(([*none * self.n, *a], b) for a, b in U)], regions)
        rows = self._rows(k)
        for piece in pieces:
            own = [([Fraction(int(e)) for e in row[:-1]], -Fraction(int(row[-1]))) for row in piece.part.rows]
            *output, last = piece.output.tolist()
            u = [[Fraction(int(entry), int(last[-1])) for entry in row] for row in output]
            if uncovered([*rows, *own], [[in_states(row, u) for row in region] for region in regions]):
                return False
        return True


def in_states(row, u):
    """The row (a, b) of (x, u) as one of x where u = (K, g) (x, 1)."""
    a, b = row
    n = len(u[0]) - 1
    return tuple(e + dot(a[n:], column) for e, column in zip(a[:n], zip(*u))), b - dot(a[n:], [f[-1] for f in u])


def uncovered(domain, regions):
    """A point of a set that no region contains, or None; all of them rows (a, b) of fractions."""
    cell = partition._Cell()
    for a, b in domain:
        cell = cell and cell.with_row(rational(tuple(a)), rational(b))
    return None if cell is None else cell.without([[(rational(tuple(a)), rational(b)) for a, b in R] for R in regions])


def tops(loop, F, V):
    """h of R_1(F) along V, rounded up; attained values, less what they may be off, where there are too many cells."""
    try:
        return mr.support(loop, F, V, engine="exact").bound
    except CellLimitError:
        found = mr.support(loop, F, V).value
        return found - ERROR * (1 + np.abs(found))


_LOOPS = {}  # those that were built last, for mutations leave most of them alone


def _power(z, powers):
    found = 1.0
    for base, power in zip(z, powers):
        for _ in range(power):
            found = found * base
    return found


# -- small worlds, by brute force ---------------------------------------------------------------------


class World:
    """What is true of a content of few small numbers, by brute force in fractions; `verdict` for every claim.

    Phi is affine for every choice of a channel per neuron of its one hidden layer. Whatever the loop does to a set is
    decided in the corners of the sets {x in the set, choice wins, (x, u) in the region, u in U}, in each of which n
    rows are tight. In the plane a gap between them is as large as a face of all those lines.
    """

    def __init__(self, content):
        self.content, self.claims, system = content, content["claims"], content["system"]
        self.n = len(content["template"][0])
        self.sets = [[(fractions(a), Fraction(b)) for a, b in zip(content["template"], h)] for h in content["sets"]]
        self.X, self.U = exact_rows(system["state_set"]), exact_rows(system["input_set"])
        self.modes = [
            (
                [fractions((*A, *B)) for A, B in zip(mode["A"], mode["B"])],
                fractions(mode["p"]),
                exact_rows(mode["region"]),
                corners_of(exact_rows(mode["disturbance"])),
            )
            for mode in system["modes"]
        ]
        self.last, self.corners = len(self.sets) - 1, [corners_of(rows) for rows in self.sets]
        self.known, self.images = {}, {}
        self.choices = list(self._choices(content["network"]))

    def _choices(self, network):
        """(K, g) of u = K x + g and the rows where it holds, for every choice of channels; K has a row per input."""
        output = [fractions((*w, b)) for w, b in zip(network["output"]["weight"], network["output"]["bias"])]
        if not network["hidden"]:
            yield output, []
            return
        (layer,) = network["hidden"]
        channels = [fractions((*w, b)) for w, b in zip(layer["weight"], layer["bias"])]
        groups = [channels[i : i + layer["pool"]] for i in range(0, len(channels), layer["pool"])]
        for won in product(*groups):
            rows = [
                (tuple(map(Fraction.__sub__, other[:-1], own[:-1])), own[-1] - other[-1])
                for own, group in zip(won, groups)
                for other in group
            ]
            n = self.n
            yield (
                [(*(dot(row[:-1], [f[i] for f in won]) + row[-1] * (i == n) for i in range(n + 1)),) for row in output],
                rows,
            )

    def _cells(self, rows):
        """(mode, u, rows): where a mode acts on the set, with its affine input."""
        for u, wins in self.choices:
            for mode in self.modes:
                limits = [*mode[2], *(((*[Fraction(0)] * self.n, *a), b) for a, b in self.U)]
                yield mode, u, [*rows, *self.X, *wins, *(in_states(row, u) for row in limits)]

    def _images(self, rows):
        """The corners of the image of a set, of which the image is in the hull, each piece by itself."""
        for (AB, p, _, D), u, all_rows in self._cells(rows):
            for x in corners_of(all_rows):
                z = (*x, *(dot(f, (*x, 1)) for f in u))
                after = [dot(a, z) + e for a, e in zip(AB, p)]
                yield from ([a + e for a, e in zip(after, d)] for d in D)

    def _has_gap(self):
        """Between the corners of all lines, from left to right, every face has a point in one of these columns."""
        rows, ends = self.sets[0], self.corners[0]
        cells = [inside for _, _, inside in self._cells(rows)]
        if self.n != 2:
            return uncovered(rows, cells) is not None
        lines = {row for inside in cells for row in inside if any(row[0])}
        if len(ends) == 2:
            columns = [line_through(*ends)]
        else:
            stops = sorted({x[0] for pair in combinations(lines, 2) for x in crossing(*pair) if holds(rows, x)})
            columns = [((Fraction(1), Fraction(0)), (a + b) / 2) for a, b in pairwise(stops)]
        points = list(ends)
        for column in columns:
            stops = sorted({x for line in lines for x in crossing(column, line) if holds(rows, x)})
            points += [tuple((a + b) / 2 for a, b in zip(*pair)) for pair in pairwise(stops)]
        return any(not any(holds(inside, x) for inside in cells) for x in points)

    def verdict(self, name):
        if name not in self.known:
            self.known[name] = getattr(self, name)()
        return self.known[name]

    def replays(self, claim, witness):
        """Whether a witness against `claim` is one: a state without a successor, or a step that leads out."""
        x, u = fractions(witness["state"]), None
        for f, wins in self.choices:
            if holds(wins, x):
                u = [dot(row, (*x, 1)) for row in f]
        acting = [mode for mode in self.modes if holds(self.X, x) and holds(self.U, u) and holds(mode[2], (*x, *u))]
        if claim == "inputs":
            return holds(self.X, x) and not holds(self.U, u)
        if witness.keys() == {"state"}:
            beyond = any(holds(rows, x) for rows in self.sets) and not holds(self.sets[0], x)
            return beyond or (holds(self.sets[0], x) and not acting)
        mode, d = self.modes[witness["mode"] - 1], fractions(witness["disturbance"])
        after = [dot(a, (*x, *u)) + e + w for a, e, w in zip(mode[0], mode[1], d)]
        pairs = {"safe_set": [(0, 0)], "terminal_set": [(self.last, self.last)]}
        pairs = pairs.get(claim, [(k, k + 1) for k in range(self.last)])
        leads_out = any(holds(self.sets[k], x) and not holds(self.sets[j], after) for k, j in pairs)
        in_box = all(min(e) <= w <= max(e) for w, e in zip(d, zip(*mode[3])))
        return mode in acting and in_box and leads_out and after == list(fractions(witness["after"]))

    def inputs(self):
        bad = any(
            not holds(self.U, [dot(f, (*x, 1)) for f in u])
            for u, wins in self.choices
            for x in corners_of([*self.X, *wins])
        )
        return "refuted" if bad else "proven"

    def safe_set(self):
        F = self.corners[0]
        fine = F and all(holds(self.X, x) for x in F) and not self._has_gap() and self._leads(0, 0)
        return "proven" if fine else "refuted"

    def _leads(self, k, j):
        if k not in self.images:
            self.images[k] = list(self._images(self.sets[k]))
        return all(holds(self.sets[j], x) for x in self.images[k])

    def _within(self, k):
        return all(holds(self.sets[0], x) and holds(self.X, x) for x in self.corners[k])

    def sequence(self):
        return "proven" if all(self._within(k) and self._leads(k, k + 1) for k in range(self.last)) else "refuted"

    def terminal_set(self):
        if self.claims["terminal_set"]["steps"] != self.last:
            return "refuted"
        if "refuted" in (self.verdict("safe_set"), self.verdict("sequence")):
            return "not checked"
        return "proven" if self._within(self.last) and self._leads(self.last, self.last) else "refuted"

    def criterion(self):
        claim = self.claims["criterion"]
        if (self.verdict("safe_set"), self.verdict("terminal_set")) != ("proven", "proven"):
            return "not checked"
        return "proven" if self.criterion_holds() == claim["holds"] else "refuted"

    def criterion_holds(self):
        claim = self.claims["criterion"]
        c, epsilon = fractions(claim["centre"]), Fraction(claim["epsilon"])
        if not holds(self.sets[-1], c):
            return False
        smaller = [tuple(m + (e - m) / (1 + epsilon) for e, m in zip(x, c)) for x in self.corners[-1]]
        S = [(a, dot(a, c) + (b - dot(a, c)) / (1 + epsilon)) for a, b in self.sets[-1]]
        images = list(self._images(S))
        return all(any(dot(a, y) >= max(dot(a, x) for x in smaller) for y in images) for a, _ in S)

    def alpha(self):
        return growth_of(self.sets[-2], self.corners[-1], fractions(self.claims["theorem_1"]["centre"]))

    def theorem_1(self):
        claim, alpha = self.claims["theorem_1"], self.alpha() if self.corners[-1] else None
        stable = alpha is not None and alpha > 1
        if not self.corners[-1] or (claim["alpha"], claim["stable"]) != (alpha and str(alpha), stable):
            return "refuted"
        rests = [self.verdict(name) for name in ("inputs", "safe_set", "sequence", "terminal_set")]
        return "proven" if not stable or set(rests) == {"proven"} else "not checked"


def fractions(values):
    return tuple(map(Fraction, values))


def exact_rows(value):
    return [(fractions(a), Fraction(b)) for a, b in zip(value["H"], value["h"])]


def line_through(x, y):
    """The row (a, b) of the line a x = b through two points."""
    a = (x[1] - y[1], y[0] - x[0])
    return a, dot(a, x)


def crossing(row, other):
    """The point in which two lines a x = b meet, in a list that is empty if they are parallel."""
    (a, b), (c, d) = row, other
    turn = a[0] * c[1] - a[1] * c[0]
    return [((b * c[1] - d * a[1]) / turn, (a[0] * d - c[0] * b) / turn)] if turn else []


@cache
def small_world(seed, n=2):
    """A World whose answers are kept."""
    return World(small_content(seed, n))


def with_cases(content):
    """A content with a proof by cases of its claims, as far as one is found."""
    system, claim = content["system"], content["claims"]["criterion"]
    modes = [
        mr.Mode(*(floats(mode[name]) for name in "ABp"), polytope(mode["region"]), polytope(mode["disturbance"]))
        for mode in system["modes"]
    ]
    X, network = polytope(system["state_set"]), mr.MaxoutNetwork.from_dict(content["network"])
    with patch("mireach.systems.pwa._check_partition"):
        loop = mr.ClosedLoop(mr.PWASystem(modes, X, mr.Polytope.box(*enclosing_inputs(network, X))), network)
    prover = CaseProver(loop, floats(content["template"]), content)
    terminal = SimpleNamespace(centre=floats(claim["centre"]), epsilon=claim["epsilon"]) if claim["holds"] else None
    return {**content, "format": checker.WITH_CASES, "cases": prover.cases(floats(content["sets"]), terminal)}


def small_content(seed, n=2):
    """A content for `World`: ties, jumps, overlaps, gaps, flat sets, sets that fit exactly or fail by one ulp."""
    rng = np.random.default_rng(seed)

    def draw(size, top, unit):
        return (rng.integers(-top, top + 1, size) / unit).tolist()

    m, square = int(rng.integers(1, 3)), np.vstack([np.eye(n), -np.eye(n)]).tolist()
    hidden, inner = [], n
    if rng.random() < 0.7:
        hidden, inner = [{"weight": draw((4, n), 2, 1), "bias": draw(4, 1, 2), "pool": 2}], 2
    output = {"weight": draw((m, inner), 2, 4), "bias": draw(m, 1, 4)}
    limit = float(rng.choice([0.75, 8.0, 8.0, 8.0]))
    U = {"H": [[s * (i == j) for j in range(m)] for i in range(m) for s in (1.0, -1.0)], "h": [limit] * 2 * m}
    kind = rng.choice(["one", "two", "gap", "overlap", "three"])
    a, b = draw(n, 1, 1) + draw(m, 1, 2), draw((), 2, 4)
    regions = [([a], [b]), ([[-e for e in a]], [-b - {"gap": 2.0**-20, "overlap": -0.25}.get(kind, 0.0)])]
    if kind == "one":
        regions = [([[0.0] * (n + m)], [0.0])]
    if kind == "three":
        more = draw(n + m, 1, 1)
        regions = [regions[0], *((regions[1][0] + [[s * e for e in more]], regions[1][1] + [0.0]) for s in (1.0, -1.0))]
    modes = []
    for H, h in regions:
        r, middle = draw(n, 1, 16), draw(n, 1, 16)
        D = [abs(reach) + sign * at for sign in (1, -1) for reach, at in zip(r, middle)]
        one = {"A": draw((n, n), 3, 8), "B": draw((n, m), 1, 8), "p": draw(n, 1, 8), "region": {"H": H, "h": h}}
        modes.append({**one, "disturbance": {"H": square, "h": D}})
    template = square + [[1.0] * n, [-1.0] + [1.0] * (n - 1)] * bool(rng.integers(2))
    F = [1.0] * 2 * n + [float(rng.choice([1.5, 2.0]))] * (len(template) - 2 * n)
    if rng.random() < 0.1:
        F[0], F[n] = 0.5, -0.5  # flat
    scale = float(rng.choice([1.0, 0.25, 0.75, 3.0]))
    template, F = [[scale * entry for entry in row] for row in template], [scale * entry for entry in F]
    X = {"H": square, "h": [float(rng.choice([1.0, 1.0, 1.0, 0.875, 2.0]))] * 2 * n}
    content = {
        "format": "mireach-certificate/1",
        "system": {"modes": modes, "state_set": X, "input_set": U},
        "network": {"format": "mireach-network/1", "hidden": hidden, "output": output},
        "template": template,
        "sets": [F],
        "claims": {"inputs": {}, "safe_set": {}},
    }
    epsilon, steps = float(rng.choice([0.125, 0.1, 1.0])), int(rng.integers(1, 4))
    for _ in range(steps):
        world, before = World(content), content["sets"][-1]
        images = list(world._images(world.sets[-1]))
        top = [max([dot(fractions(a), y) for y in images], default=Fraction(0)) for a in template]
        following = [min(up(value), b) for value, b in zip(top, before)]
        if rng.random() < 0.1:
            i = int(rng.integers(len(template)))
            following[i] = float(np.nextafter(following[i], -np.inf))
        content["sets"].append(before if rng.random() < 0.1 else following)
    centre = rng.choice([0.0, 0.125, 0.25, 1.0], n, p=[0.6, 0.2, 0.1, 0.1]).tolist()
    content["claims"] |= {
        "sequence": {},
        "terminal_set": {"steps": steps if rng.random() < 0.9 else steps + int(rng.choice([-1, 1]))},
        "criterion": {"epsilon": epsilon, "centre": centre, "holds": True},
        "theorem_1": {"alpha": None, "centre": centre, "stable": False},
    }
    world = World(content)
    alpha = world.alpha() if world.corners[-1] else None
    content["claims"]["criterion"]["holds"] = bool(world.criterion_holds()) != bool(rng.random() < 0.1)
    told = alpha if rng.random() < 0.9 else Fraction(1)
    content["claims"]["theorem_1"]["alpha"] = None if told is None else str(told)
    content["claims"]["theorem_1"]["stable"] = bool(alpha is not None and alpha > 1) != bool(rng.random() < 0.1)
    content["claims"] = {name: {"verdict": "proven", **claim} for name, claim in content["claims"].items()}
    return content


def up(value):
    """The smallest float that is not below a fraction."""
    near = float(value)
    return near if Fraction(near) >= value else float(np.nextafter(near, np.inf))
