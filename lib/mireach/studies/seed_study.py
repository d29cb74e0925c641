"""The seed study: how typical are the numbers of one trained network?"""

import csv
import hashlib
import io
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from ..analysis.maximal_set import maximal_safe_set
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import terminal_set
from ..certificate.writer import write
from ..checks import require_bools, whole_number
from ..engines.cells import cells
from ..errors import CorruptFileError, MireachError, MissingExtraError
from ..files import END, PART, read_json, write_json, write_whole
from ..learning.datasets import DataSet
from ..systems.network import MaxoutNetwork
from ..workers import in_parallel
from .case_studies import CaseStudy, case_definition, case_study, data_file, paper_case_definition

FINISHED = "mireach-finished-seed/1"  # format of a file that keeps one seed of an unfinished study
CLEAR = 1e-6  # an alpha counts as above 1 by more than this, what a MILP solver resolves
PACKAGE = Path(__file__).parents[1]  # whose code decides what a seed leads to
LOSS_FACTOR = 2.0  # a network may be shipped if its loss is within this factor of the best eligible one


@dataclass(frozen=True)
class SeedRow:
    """What one seed led to.

    Attributes
    ----------
    seed : int
    loss : float
        Mean squared error on the data, in units of u^2.
    cells : int
        Cells of the closed loop over X.
    verdict : str
        Of the safe set.
    iterations : int
        Of the safe set; where none was found, how many were made.
    x1_min, x1_max, x2_min, x2_max : float
        Extent of F_max; nan if none was found.
    steps, criterion, alpha : int, bool, float
        k-bar about the origin, whether eq. (25), TerminationFmin, held there, and the alpha of Theorem 1.
    steps_equilibrium, criterion_equilibrium, alpha_equilibrium : int, bool, float
        The same about the closed loop's equilibrium; 0, False and nan if it has none.
    train_seconds, analysis_seconds : float
        The latter without what follows.
    safe_area : float
        Of F_max, in units of x1 times x2; 0 if none was found.
    maximal_verdict : str
        Of the maximal safe set.
    maximal_area, area_ratio : float
        Of the maximal safe set (0 if none was found), and how many times F_max that is (nan without F_max).
    maximal_iterations : int
        Of the maximal safe set.
    maximal_seconds : float
        For that set, its outer bound and its proof.
    """

    seed: int
    loss: float
    cells: int
    verdict: str
    iterations: int
    x1_min: float = np.nan
    x1_max: float = np.nan
    x2_min: float = np.nan
    x2_max: float = np.nan
    steps: int = 0
    criterion: bool = False
    alpha: float = np.nan
    steps_equilibrium: int = 0
    criterion_equilibrium: bool = False
    alpha_equilibrium: float = np.nan
    train_seconds: float = np.nan
    analysis_seconds: float = np.nan
    safe_area: float = 0.0
    maximal_verdict: str = ""
    maximal_area: float = 0.0
    area_ratio: float = np.nan
    maximal_iterations: int = 0
    maximal_seconds: float = np.nan

    def __str__(self) -> str:
        return (
            f"seed {self.seed}: loss {self.loss:.4g}, F_max {self.verdict} after {self.iterations} iterations, "
            f"k-bar = {self.steps}, alpha = {self.alpha:.9g}"
        )


Networks = dict[int, MaxoutNetwork]  # by seed
Finished = tuple[SeedRow, MaxoutNetwork]  # what one seed leads to


def study(
    name: str,
    seeds: Iterable[int] = range(50),
    *,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: bool = False,
    keep: str | Path | None = None,
    **training: Any,
) -> tuple[list[SeedRow], Networks]:
    """Train and analyse one network per seed.

    Parameters
    ----------
    name : str
        Of the case study.
    seeds : iterable of int
    jobs : int
        Processes on this machine, -1 for all cores.
    scheduler : str or None
        Address of a Dask scheduler, "tcp://host:8786", whose workers are used in place of `jobs`.
    progress : bool
        Show a progress bar.
    keep : str, Path or None
        A folder that gets one file per finished seed. Seeds that it holds already are not trained again, if they
        were made from the same data, options, code of this package and version of PyTorch.
    **training
        Passed to `training.train`, such as `steps`.

    Returns
    -------
    rows : list of SeedRow
        By seed.
    networks : dict of int to MaxoutNetwork

    Raises
    ------
    MissingExtraError
        If `scheduler` is given and dask.distributed is missing, or more than one job is asked for and joblib is.
    ValueError
        If there is no such case.
    """
    require_bools(progress=progress)
    chosen = list(dict.fromkeys(map(int, seeds)))
    store = None if keep is None else _Store(Path(keep), _origin(name, training))
    finished = {} if store is None else store.load(chosen)
    tasks = [(name, seed, training) for seed in chosen if seed not in finished]
    bar = tqdm(total=len(chosen), initial=len(finished), desc="seeds", unit="network", disable=not progress)
    with bar:
        for row, network in _results(tasks, jobs, scheduler):
            finished[row.seed] = row, network
            if store is not None:
                store.save(row, network)
            bar.update()
    ordered = [finished[seed] for seed in sorted(finished)]
    return [row for row, _ in ordered], {row.seed: network for row, network in ordered}


def _results(tasks: Sequence[tuple[str, int, dict[str, Any]]], jobs: int, scheduler: str | None) -> Iterator[Finished]:
    """Yield (SeedRow, MaxoutNetwork) of each task, as soon as it is there."""
    if scheduler is None:
        yield from in_parallel(_run_task, tasks, jobs, ordered=False)
        return
    try:
        from dask.distributed import Client, as_completed
    except ImportError as error:
        raise MissingExtraError("a scheduler", "dask", "cluster") from error
    with Client(scheduler) as client:
        futures = [client.submit(_run_task, *task, pure=False) for task in tasks]
        for future in as_completed(futures):
            yield future.result()


def _run_task(name: str, seed: int, training: dict[str, Any]) -> Finished:
    return run_seed(name, seed, **training)


def run_seed(name: str, seed: int, **training: Any) -> Finished:
    """Train the network of one seed and analyse it: (SeedRow, MaxoutNetwork)."""
    begin = perf_counter()
    network, loss = train_case(name, seed, progress=False, **training)
    seconds = perf_counter() - begin
    return replace(analyse_seed(name, seed, network, loss), train_seconds=seconds), network


def train_case(name: str, seed: int, data: DataSet | None = None, **training: Any) -> tuple[MaxoutNetwork, float]:
    """The network of one seed, trained on the shipped data of a case (or on `data`): (MaxoutNetwork, loss).

    One thread, so that a seed gives the same network whatever else runs.
    """
    _torch().set_num_threads(1)
    from ..learning.training import train

    definition = case_definition(name)
    data = DataSet.load(data_file(name, "samples.csv")) if data is None else data
    lower, upper = definition.plant().input_set.bounding_box()
    options = {**definition.shape._asdict(), "lower": lower, "upper": upper, "rng": seed, **training}
    result = train(data.states, data.inputs, **options)
    return result.network, result.loss


def _torch() -> ModuleType:
    """PyTorch, with the error that names the extra where it is missing."""
    try:
        import torch
    except ImportError as error:
        raise MissingExtraError("training", "torch", "train") from error
    return torch


def analyse_seed(name: str, seed: int, network: MaxoutNetwork, loss: float) -> SeedRow:
    """The sets of a trained network, as a SeedRow."""
    begin = perf_counter()
    case = case_study(name, network)
    safe = safe_set(case.loop, case.safe_directions)
    row: dict[str, Any] = {"seed": seed, "loss": loss, "cells": len(cells(case.loop)), "verdict": safe.verdict}
    row["iterations"] = safe.iterations
    if safe.set is not None:
        lower, upper = safe.set.bounding_box()
        row |= {"x1_min": lower[0], "x2_min": lower[1], "x1_max": upper[0], "x2_max": upper[1]}
        row |= _terminal_columns(case, safe, "origin", "") | _terminal_columns(
            case, safe, "equilibrium", "_equilibrium"
        )
    row["analysis_seconds"] = perf_counter() - begin
    row |= _maximal_columns(case, safe)
    return SeedRow(**{key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()})


def _terminal_columns(case: CaseStudy, safe: SafeSet, centre: str, suffix: str) -> dict[str, Any]:
    """The columns of the terminal set about a centre; none where the loop has no equilibrium."""
    try:
        terminal = terminal_set(case.loop, safe, case.directions, case.epsilon, centre)
    except ValueError:
        return {}
    return {
        "steps" + suffix: terminal.steps,
        "criterion" + suffix: terminal.criterion,
        "alpha" + suffix: terminal.alpha,
    }


def reanalyse(name: str, jobs: int = -1, folder: str | Path | None = None, *, progress: bool = False) -> str:
    """Compute the columns of the maximal safe set for the networks of a shipped study, without training.

    Parameters
    ----------
    name : str
        Of the case study.
    jobs : int
        Processes on this machine, -1 for all cores.
    folder : str, Path or None
        Where seeds.csv is written; None is the case's folder in `data`. The other columns stay as they are.
    progress : bool

    Returns
    -------
    str
        What came out, for people.
    """
    rows, networks = load_study(name)
    columns = in_parallel(_maximal_of, [(name, networks[row.seed]) for row in rows], jobs)
    require_bools(progress=progress)
    shown = tqdm(columns, total=len(rows), desc="seeds", unit="network", disable=not progress)
    rows = [replace(row, **maximal) for row, maximal in zip(rows, shown)]
    path = Path(folder or data_file(name, "")) / "seeds.csv"
    save_rows(path, rows)
    ratios = [row.area_ratio for row in rows if np.isfinite(row.area_ratio)]
    proven = sum(row.maximal_verdict == "proven" for row in rows)
    return (
        f"{path}: {proven} of {len(rows)} networks have a proven maximal safe set; where there is an F_max, its area "
        f"is {min(ratios):.3g} to {max(ratios):.3g} times that of F_max, {np.median(ratios):.3g} in the middle"
    )


def choose(name: str, rows: Sequence[SeedRow]) -> SeedRow:
    """The row that is shipped: the nearest to the paper's numbers among networks that fit about as well as any.

    Parameters
    ----------
    name : str
    rows : list of SeedRow

    Returns
    -------
    SeedRow

    Raises
    ------
    MireachError
        If for no row all of the paper's claims hold.

    Notes
    -----
    Eligible are rows for which the paper's claims hold (a proven safe set, eq. (25), TerminationFmin, about the
    origin, alpha > 1 by more than `CLEAR`) and whose loss is within twice the best loss of such rows. The
    distance is the sum of the relative differences of the numbers that the paper prints: iterations of
    F_max, k-bar, and where it prints the box F_max its right end, the side that differs between the networks.

    Examples
    --------
    >>> rows, networks = load_study("pwa")
    >>> networks[choose("pwa", rows).seed].to_dict() == case_study("pwa").network.to_dict()
    True
    """
    paper = paper_case_definition(name).paper
    sound = [row for row in rows if row.verdict == "proven" and row.criterion and row.alpha > 1 + CLEAR]
    if not sound:
        raise MireachError(f"none of {len(rows)} networks of case {name} has both sets and alpha > 1; train more seeds")
    best = min(row.loss for row in sound)
    good = [row for row in sound if row.loss <= LOSS_FACTOR * best]

    def distance(row: SeedRow) -> float:
        pairs: list[tuple[float, float]] = [(row.iterations, paper["iterations"]), (row.steps, paper["steps"])]
        if "safe_set_box" in paper:
            pairs.append((row.x1_max, paper["safe_set_box"][1][0]))
        return sum(abs(here - there) / there for here, there in pairs)

    return min(good, key=distance)


def save_rows(path: str | Path, rows: Sequence[SeedRow]) -> None:
    """Write the study as CSV whose numbers read back to the same floats; the last line gives the number of rows."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(SeedRow))
    writer.writerows(asdict(row).values() for row in rows)
    write_whole(path, text.getvalue() + END.format(len(rows)) + "\n")


def load_rows(path: str | Path) -> list[SeedRow]:
    """Read a study that `save_rows` wrote: list of SeedRow. An older study may lack the last columns.

    Raises
    ------
    CorruptFileError
        If the file is not such a study.

    Examples
    --------
    >>> len(load_rows(data_file("pwa", "seeds.csv"))) >= 50
    True
    """
    columns = [field.name for field in fields(SeedRow)]
    try:
        *lines, end = Path(path).read_text(encoding="utf-8").splitlines() or [""]
        reader = csv.DictReader(lines)
        needed = [field.name for field in fields(SeedRow) if field.default is MISSING]
        names = reader.fieldnames or []
        if names != columns[: len(names)] or len(names) < len(needed):
            raise ValueError("its first line does not name the columns of SeedRow")
        if end != END.format(len(lines) - 1):
            raise ValueError("its last line does not give the number of rows it holds; it is truncated")
        return [_row(row) for row in reader]
    except (KeyError, TypeError, ValueError) as error:
        raise CorruptFileError(f"{path} holds no seed study: {error!r}; make it again") from error


def _row(texts: dict[str, str]) -> SeedRow:
    """The SeedRow of a dict of column to text."""
    readers: dict[Any, Callable[[str], Any]] = {bool: {"True": True, "False": False}.__getitem__}
    kinds: dict[str, Any] = {field.name: field.type for field in fields(SeedRow)}
    return SeedRow(**{key: readers.get(kinds[key], kinds[key])(text) for key, text in texts.items()})


def save_networks(path: str | Path, networks: Networks) -> None:
    """Write the networks of a study, one JSON object per line: {"seed": ..., "network": ...}, and {"end": count}."""
    lines = [json.dumps({"seed": seed, "network": network.to_dict()}) for seed, network in sorted(networks.items())]
    write_whole(path, "\n".join([*lines, json.dumps({"end": len(lines)})]) + "\n")


def load_networks(name: str) -> Networks:
    """All networks of the shipped seed study of a case: dict of seed to MaxoutNetwork.

    Raises
    ------
    CorruptFileError
        If the file is truncated or holds anything else.
    """
    path = data_file(name, "seed_networks.jsonl")
    try:
        *entries, end = map(json.loads, path.read_text(encoding="utf-8").splitlines() or ["null"])
        networks = {entry["seed"]: MaxoutNetwork.from_dict(entry["network"]) for entry in entries}
        if end != {"end": len(networks)} or len(networks) < len(entries):
            raise ValueError("its last line does not give the number of networks it holds; it is truncated")
        return networks
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise CorruptFileError(f"{path} holds no networks of a seed study: {error!r}; restore it") from error


def load_study(name: str) -> tuple[list[SeedRow], Networks]:
    """Rows and networks of the shipped seed study of a case: (list of SeedRow, dict of seed to MaxoutNetwork).

    Raises
    ------
    CorruptFileError
        If a file is truncated or holds anything else, or the two hold different seeds.

    Examples
    --------
    >>> rows, networks = load_study("pwa")
    >>> networks[rows[0].seed].input_size
    2
    """
    rows, networks = load_rows(data_file(name, "seeds.csv")), load_networks(name)
    if sorted(row.seed for row in rows) != sorted(networks):
        raise CorruptFileError(
            f"{data_file(name, 'seeds.csv')} has {len(rows)} seeds that are not the {len(networks)} of "
            "seed_networks.jsonl beside it; restore both files, or run the study again"
        )
    return rows, networks


def _origin(name: str, training: dict[str, Any]) -> str:
    """A digest of all that decides what a seed leads to: data, options, this package, and the version of PyTorch."""
    digest = hashlib.sha256(f"{name} {sorted(training.items())} {_torch().__version__} {np.__version__}".encode())
    for path in [data_file(name, "samples.csv"), *sorted(PACKAGE.rglob("*.py"))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Store:
    """A folder that keeps the finished seeds of one study, one file each; `origin` tells studies apart."""

    folder: Path
    origin: str

    def save(self, row: SeedRow, network: MaxoutNetwork) -> None:
        """Write what one seed led to."""
        numbers = {key: str(value) for key, value in asdict(row).items()}
        content = {"format": FINISHED, "origin": self.origin, "row": numbers, "network": network.to_dict()}
        write_json(self.folder / f"{row.seed}.json", content)

    def load(self, seeds: Iterable[int]) -> dict[int, Finished]:
        """What `save` wrote of these seeds, if its origin is the same: by seed."""
        finished = {}
        for seed in seeds:
            with suppress(FileNotFoundError, CorruptFileError, KeyError, TypeError, ValueError):  # is run again
                value = read_json(self.folder / f"{seed}.json", FINISHED)
                row = _row(value["row"])
                if value["origin"] == self.origin and row.seed == seed:
                    finished[seed] = row, MaxoutNetwork.from_dict(value["network"])
        return finished


def make_study(
    name: str,
    count: int = 50,
    *,
    jobs: int = -1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> str:
    """Run the study of a case and write seeds.csv, seed_networks.jsonl and the chosen network.json.

    A study that was interrupted is resumed: finished networks are kept in the folder seeds.part until it ends.

    Parameters
    ----------
    name : str
    count : int
        Seeds 0, ..., count - 1.
    jobs, scheduler, progress
        As in `study`.
    folder : str, Path or None
        None is the case's folder in `data`.

    Returns
    -------
    str
        What was chosen, for people.
    """
    paper_case_definition(name)
    count = whole_number(count, "count", 1)
    if scheduler is None and not jobs:
        raise ValueError("jobs must not be 0; -1 is one process per core")
    folder = Path(folder or data_file(name, ""))
    keep = folder / f"seeds{PART}"
    rows, networks = study(name, range(count), jobs=jobs, scheduler=scheduler, progress=progress, keep=keep)
    save_rows(folder / "seeds.csv", rows)
    save_networks(folder / "seed_networks.jsonl", networks)
    chosen = choose(name, rows)
    networks[chosen.seed].save(folder / "network.json")
    shutil.rmtree(keep, ignore_errors=True)
    return f"seed {chosen.seed} of {count} is written to {folder / 'network.json'}: {chosen}"


def retrain(name: str, seed: int | None = None, folder: str | Path | None = None, *, progress: bool = False) -> str:
    """Make the data set of a case and train one network on it, from scratch.

    Parameters
    ----------
    name : str
    seed : int or None
        None is the seed whose network is shipped: that of the study, or 0 for a case without one.
    folder : str, Path or None
        Where samples.csv and network.json are written, and certificate.json for a case with more than two states;
        None is the case's folder in `data`.
    progress : bool

    Returns
    -------
    str
        What came out, for people.
    """
    definition = case_definition(name)
    if seed is None:
        seed = choose(name, load_rows(data_file(name, "seeds.csv"))).seed if definition.paper else 0
    folder = Path(folder or data_file(name, ""))
    data = definition.make_data(progress=progress)
    data.save(folder / "samples.csv")
    network, loss = train_case(name, seed, data, progress=progress)
    network.save(folder / "network.json")
    outcome = analyse_seed(name, seed, network, loss) if definition.paper else _certify(name, network, folder, progress)
    return f"{data!r}; seed {seed}, loss {loss:.6g}, written to {folder}; {outcome}"


def _certify(name: str, network: MaxoutNetwork, folder: Path, progress: bool) -> str:
    """Find F_max and the terminal set of a trained network and write certificate.json: what came out, for people."""
    case = case_study(name, network)
    safe = safe_set(case.loop, case.safe_directions, progress=progress)
    if safe.set is None:
        return f"no F_max: {safe.reason}"
    terminal = terminal_set(case.loop, safe, case.directions, case.epsilon, progress=progress)
    write(folder / "certificate.json", case.loop, safe, terminal)
    return f"F_max after {safe.iterations} iterations; {terminal.reason}, alpha = {terminal.alpha:.9g}"


def _maximal_of(name: str, network: MaxoutNetwork) -> dict[str, Any]:
    """The columns of the maximal safe set for a network."""
    case = case_study(name, network)
    return _maximal_columns(case, safe_set(case.loop, case.safe_directions))


def _maximal_columns(case: CaseStudy, safe: SafeSet) -> dict[str, Any]:
    """The columns of the maximal safe set: dict."""
    begin = perf_counter()
    maximal = maximal_safe_set(case.loop)
    seconds = perf_counter() - begin
    safe_area, area = (0.0 if part.set is None else part.set.area for part in (safe, maximal))
    return {
        "safe_area": safe_area,
        "maximal_verdict": maximal.verdict,
        "maximal_area": area,
        "area_ratio": area / safe_area if safe_area else np.nan,
        "maximal_iterations": maximal.iterations,
        "maximal_seconds": seconds,
    }
