"""Runs methods on events and layouts, resumable by registration: ``python -m loadfree``."""

import argparse
import json
import time
from functools import partial

from common import commit
from loadfree.archive import SCRATCH, key_of, read_rows, scratch_path, write_results
from loadfree.bench import LOADFREE, Bench
from loadfree.events import HALVES, events_of
from loadfree.layouts import LAYOUTS, N_MARKERS, NOISE_MM
from loadfree.rivals import Case
from loadfree.score import scored
from tissuereg import TissueRegError
from tissuereg.parallel import Failed, InProcess, Processes


def arguments(words: list[str] | None, bench: Bench) -> argparse.Namespace:
    """Return the command line's settings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=[*HALVES], default="dev", help="dev: even events; test: odd ones")
    parser.add_argument("--bodies", nargs="+", choices=bench.bodies, default=list(bench.bodies))
    parser.add_argument("--layouts", nargs="+", choices=LAYOUTS, default=list(bench.layouts))
    parser.add_argument("--methods", nargs="+", choices=bench.methods, default=list(bench.usual))
    parser.add_argument("--limit", type=int, help="the first events of each body only")
    parser.add_argument("--events", nargs="+", type=int, help="events of these numbers only")
    parser.add_argument("--jobs", type=int, default=1, help="events side by side, one thread each")
    parser.add_argument("--again", action="store_true", help="forget what these methods have answered so far")
    return parser.parse_args(words)


def main(words: list[str] | None = None, bench: Bench = LOADFREE) -> None:
    """Run what is missing, then write the results of the half and print their path."""
    options = arguments(words, bench)
    SCRATCH.mkdir(parents=True, exist_ok=True)
    for method in options.methods:
        path = scratch_path(options.half, method, bench)
        if options.again:
            path.unlink(missing_ok=True)
        wanted = list(_wanted(options, bench))
        done = {key_of(row) for row in read_rows(path)}
        tasks = [(method, body, number, _left(options, body, number, done)) for body, number in wanted]
        begun = time.time()
        _run(bench, [task for task in tasks if task[3]], options.jobs, path)
        rows = [
            row for row in read_rows(path) if (row["body"], row["event"]) in wanted and row["layout"] in options.layouts
        ]
        failed = sum("error" in row for row in rows)
        write_results(bench, options.half, method, rows, _conditions(options))
        print(f"{method}: {len(rows)} registrations, {failed} failed, {time.time() - begun:.0f} s", flush=True)


def answer_event(task: tuple[str, str, int, list[str]], bench: Bench = LOADFREE) -> list[dict]:
    """Return the rows of one method on one event, one per layout."""
    method, name, number, layouts = task
    body = bench.read(name)
    event = next(event for event in body.events if event.number == number)
    rows = []
    for layout in layouts:
        row = {"body": name, "event": number, "layout": layout}
        begun = time.perf_counter()
        try:
            answer = bench.methods[method](Case(body, event, layout))
        except TissueRegError as error:
            rows.append(row | {"error": f"{type(error).__name__}: {error}", "seconds": _since(begun)})
            continue
        seconds = _since(begun)
        rows.append(row | scored(event.nodes, event.targets, answer) | {"seconds": seconds})
    return rows


def _since(begun: float) -> float:
    return round(time.perf_counter() - begun, 4)


def _wanted(options: argparse.Namespace, bench: Bench):
    for name in options.bodies:
        for event in events_of(bench.read(name), options.half)[: options.limit]:
            if not options.events or event.number in options.events:
                yield name, event.number


def _left(options: argparse.Namespace, body: str, number: int, done: set) -> list[str]:
    return [layout for layout in options.layouts if (body, number, layout) not in done]


def _run(bench: Bench, tasks: list, jobs: int, path) -> None:
    """Answer events and keep each row as soon as it is there."""
    with path.open("a", encoding="utf-8") as out:

        def keep(rows: list[dict]) -> None:
            out.writelines(json.dumps(row) + "\n" for row in rows)
            out.flush()

        with InProcess() if jobs == 1 else Processes(jobs) as executor:
            for outcome in executor.run(partial(answer_event, bench=bench), tasks):
                if isinstance(outcome, Failed):
                    raise outcome.error
                keep(outcome.result)


def _conditions(options: argparse.Namespace) -> dict:
    """Return the commit and settings of the rows."""
    settings = {
        "bodies": options.bodies,
        "layouts": options.layouts,
        "limit": options.limit,
        "events": options.events,
        "jobs": options.jobs,
    }
    return commit() | {"settings": settings | {"n_markers": N_MARKERS, "noise_mm": NOISE_MM}}
