"""Implements ``stemworlds train``, which trains networks and continues interrupted trainings."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from .._text import printable
from ..bench.progress import in_words
from ..errors import StemworldsError
from . import export, packaged_configs, read_config, train

_INTERRUPTED = 130

_ABOUT = """Trains networks that find columns and say how many defects each holds, on tiles that are made as they are needed.
It writes checkpoint.pt, log.jsonl (losses by step) and at the end member-0.onnx ... to a folder. The same command continues from there;
a kill loses what came after the last checkpoint. PyTorch, onnx and onnxscript have to be installed: pip install 'stemworlds[train]'."""
_EXAMPLES = """examples:
  stemworlds train crystals --out crystals
  stemworlds train mine.toml --out mine --processes 8
  stemworlds train mine.toml --out mine --minutes 50 --json

a config, mine.toml; `stemworlds train crystals --show` prints one, docs/training.md explains the keys:
  [stream]
  recipes = ["srtio3:easy", {recipe = "mgo.toml", difficulty = "hard", weight = 2}]
  [optimiser]
  steps = 30000"""


def main(words: Sequence[str] | None = None) -> int:
    """Runs ``stemworlds train`` with these arguments; returns the exit code."""
    options = _parser().parse_args(words)
    try:
        return _run(options)
    except StemworldsError as error:
        print(f"error: {printable(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return _INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("stemworlds train", description=_ABOUT, epilog=_EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", metavar="CONFIG", help=f"TOML file, or a config of the package: {', '.join(sorted(packaged_configs()))}")
    parser.add_argument("--out", metavar="FOLDER", help="folder of checkpoint, log and networks; by default the config's name")
    parser.add_argument("--processes", type=int, metavar="N", help="processes that make tiles, in place of the config's")
    parser.add_argument("--minutes", type=float, metavar="T", help="stop at a checkpoint after so long; the same command goes on")
    parser.add_argument("--show", action="store_true", help="print the config and train nothing")
    parser.add_argument("--export", action="store_true", help="write the networks of the last checkpoint, and train nothing")
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.show:
        packaged = packaged_configs()
        print(packaged[options.config] if options.config in packaged else Path(options.config).read_text(encoding="utf-8"), end="")
        return 0
    config = read_config(options.config)
    if options.processes is not None:
        config = dataclasses.replace(config, run=dataclasses.replace(config.run, processes=options.processes))
    out = options.out if options.out is not None else Path(options.config).stem
    if options.export:
        networks = export(config, out)
        print(json.dumps({"networks": networks}) if options.json else "\n".join(networks))
        return 0
    summary = train(config, out, until=None if options.minutes is None else 60 * options.minutes)
    if options.json:
        print(json.dumps(dataclasses.asdict(summary)))
    else:
        done, steps = summary.steps
        print(f"{out}: {done} of {steps} steps, {done - summary.before} of them in {in_words(summary.seconds)}")
        for path in summary.networks:
            print(path)
    if summary.interrupted:
        print(f"interrupted: 'stemworlds train {options.config} --out {out}' goes on", file=sys.stderr)
        return _INTERRUPTED
    return 0
