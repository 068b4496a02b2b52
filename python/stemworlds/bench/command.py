"""``stemworlds bench``: runs experiments, and reports of them."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._text import printable
from ..errors import StemworldsError
from .catalogue import agent_names
from .experiments import packaged_experiments, read_experiment
from .progress import in_words
from .report import leaderboard, write_report
from .runner import RunSummary, run_experiment
from .time_left import forecast_of_time

_INTERRUPTED = 130

_ABOUT = """Run agents in worlds under a dose budget, and report their scores.
An experiment is a TOML file (agents x tasks x worlds x seeds x budgets), or the name of an experiment of the package."""
_EXAMPLES = """examples:
  stemworlds bench experiments
  stemworlds bench run main --out main.jsonl --processes 4
  stemworlds bench report main.jsonl -o main.html
  stemworlds bench leaderboard main.jsonl mine.jsonl"""
_RUN = """Play all episodes of an experiment that are not in the file of results yet. Each result is appended at the end of its episode,
so the same command continues an interrupted run. Episodes that end with an error are printed; the next run plays them again.
The first episode in a material computes its library, unless the library is installed. This takes minutes.
Later runs read the library from the cache."""
_RUN_EXAMPLES = """examples:
  stemworlds bench run quick --out quick.jsonl
  stemworlds bench run my-agents.toml --out mine.jsonl --processes 8
  stemworlds bench run main --out main.jsonl --dry-run

an experiment, my-agents.toml:
  tasks = ["defect-census", "targeted"]
  seeds = 10
  budgets = [5000]
  agents = ["Nothing", "Raster", "GP-UCB", {name = "mine", navigator = {kind = "gp", beta = 1.0}, analyst = "heuristic"}]
  worlds = ["w.h5", {recipe = "srtio3", difficulty = "easy"}]"""
_REPORT = """Make one HTML page of results, with tables beside it: PAGE-agents.csv (by task and budget),
PAGE-episodes.csv and PAGE-pairs.csv (paired tests). The page leaves out sections without data, and lists them."""
_REPORT_EXAMPLES = """examples:
  stemworlds bench report main.jsonl -o main.html
  stemworlds bench report main.jsonl rl.jsonl -o both.html"""
_LEADERBOARD = """Rank the agents of one or several files of results, by task and budget: mean DEC-AUC with its 95 % interval, and the
position between the floor (an agent that declares nothing, 0 %) and the ceiling (an agent that knows the truth, 100 %), if the results
contain both. Skill is the position between a blind agent (Prior: 0) and the ideal observer (Ideal: 1), if the results contain both and
their scores differ by 0.005 or more."""
_LEADERBOARD_EXAMPLES = """examples:
  stemworlds bench leaderboard main.jsonl
  stemworlds bench leaderboard main.jsonl mine.jsonl --json"""


def main(words: Sequence[str] | None = None) -> int:
    """Runs ``stemworlds bench`` with these arguments; returns the exit code."""
    options = _parser().parse_args(words)
    if options.command is None:
        _parser().print_help()
        return 0
    try:
        code: int = options.does(options)
        return code
    except StemworldsError as error:
        print(f"error: {printable(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # The reader of the pipe has closed it, so nothing more is printed.
        sys.stdout = None
        return 0


def _parser() -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = _described(argparse.ArgumentParser, _ABOUT, _EXAMPLES, prog="stemworlds bench")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")

    def add(name: str, does: Callable[[argparse.Namespace], int], brief: str, about: str, examples: str) -> argparse.ArgumentParser:
        own: argparse.ArgumentParser = _described(commands.add_parser, about, examples, name=name, help=brief)
        own.set_defaults(does=does)
        own.add_argument("--json", action="store_true", help="print JSON")
        return own

    run = add("run", _run, "play the episodes of an experiment", _RUN, _RUN_EXAMPLES)
    run.add_argument("experiment", metavar="EXPERIMENT", help="a TOML file, or the name of an experiment of the package")
    run.add_argument("--out", required=True, metavar="RESULTS", help="file of results (JSON lines); its episodes are not played again")
    run.add_argument("--processes", type=int, metavar="N", help="number of episodes at once [default: number of processors]")
    run.add_argument("--dry-run", action="store_true", help="print the remaining episodes and their estimated time; play none")
    report = add("report", _report, "make a page of results", _REPORT, _REPORT_EXAMPLES)
    report.add_argument("results", nargs="+", metavar="RESULTS", help="files of results")
    report.add_argument("-o", "--out", required=True, metavar="PAGE", help="the page; its name ends in .html")
    ranks = add("leaderboard", _leaderboard, "rank the agents of results", _LEADERBOARD, _LEADERBOARD_EXAMPLES)
    ranks.add_argument("results", nargs="+", metavar="RESULTS", help="files of results")
    add("experiments", _experiments, "list the experiments and agents of the package", "List the experiments and agents of the package.", "")
    return parser


def _described(make: Callable[..., Any], about: str, examples: str, **more: Any) -> Any:
    return make(description=about, epilog=examples or None, formatter_class=argparse.RawDescriptionHelpFormatter, **more)


def _run(options: argparse.Namespace) -> int:
    experiment = read_experiment(options.experiment)
    if options.dry_run:
        episodes = len(list(experiment))
        counts = {"agents": len(experiment.agents), "tasks": len(experiment.tasks), "worlds": len(experiment.worlds)}
        counts |= {"seeds": len(experiment.seeds), "budgets": len(experiment.budgets), "episodes": episodes}
        words = ", ".join(f"{count} {name if count != 1 else name.removesuffix('s')}" for name, count in counts.items())
        left = forecast_of_time(experiment, options.out, options.processes)
        print(json.dumps({"experiment": experiment.name, **counts, **dataclasses.asdict(left)}) if options.json else f"{experiment.name}: {words}; {left}")
        return 0
    summary = run_experiment(experiment, options.out, processes=options.processes)
    if options.json:
        print(json.dumps({"experiment": experiment.name, "out": options.out, **dataclasses.asdict(summary)}))
    else:
        _tell(summary, options)
    if summary.interrupted:
        return _INTERRUPTED
    return 1 if summary.failed else 0


def _tell(summary: RunSummary, options: argparse.Namespace) -> None:
    said = f"{options.out}: {summary.done} episodes in {in_words(summary.seconds)}"
    if summary.skipped:
        said += f", {summary.skipped} were there"
    print(said)
    again = f"stemworlds bench run {options.experiment} --out {options.out}"
    if summary.failed:
        print(f"error: {len(summary.failed)} episodes failed, the first: {printable(summary.failed[0])}; '{again}' tries them again", file=sys.stderr)
    if summary.interrupted:
        left = summary.episodes - summary.skipped - summary.done - len(summary.failed)
        print(f"interrupted: {left} episodes are left; '{again}' goes on", file=sys.stderr)
    elif not summary.failed:
        print(f"stemworlds bench report {options.out} -o {Path(options.out).with_suffix('.html')}")


def _report(options: argparse.Namespace) -> int:
    written = write_report(options.results, options.out)
    names = [str(path) for path in written]
    print(json.dumps({"written": names}) if options.json else "\n".join(names))
    return 0


def _leaderboard(options: argparse.Namespace) -> int:
    tables = leaderboard(options.results)
    if options.json:
        print(json.dumps(tables))
        return 0
    for number, table in enumerate(tables):
        if number:
            print()
        print(f"{table['task']}, {table['budget']:g} e/A2")
        names = {line["agent"]: printable(line["agent"]) for line in table["agents"]}
        width = max(map(len, names.values()))
        print(f"  {'':3} {'agent':<{width}}  DEC-AUC  95 % interval     of the way    skill  episodes")
        for line in table["agents"]:
            way = "" if line["of_the_way"] is None else f"{line['of_the_way']:.0%}"
            skill = "" if line["skill"] is None else f"{line['skill']:.2f}"
            low, high = line["interval"]
            mark = "" if line["role"] == "agent" else f"  {line['role']}"
            rank = "" if line["rank"] is None else str(line["rank"])
            print(
                f"  {rank:>3} {names[line['agent']]:<{width}}  {line['mean']:7.3f}  {low:6.3f} to {high:5.3f}  {way:>10}  {skill:>7}  {line['episodes']:8d}{mark}"
            )
        if table["note"]:
            print(f"  {table['note']}")
    return 0


def _experiments(options: argparse.Namespace) -> int:
    known = packaged_experiments()
    if options.json:
        print(json.dumps({"experiments": known, "agents": agent_names()}))
        return 0
    width = max(map(len, known), default=0)
    for name, about in known.items():
        print(f"{name:<{width}}  {about}")
    print(f"\nagents: {', '.join(agent_names())}")
    return 0
