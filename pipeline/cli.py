"""Verbs and flags. No logic lives here, and nothing heavy is imported before a verb needs it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any, NoReturn

from plait.pipeline.errors import EXIT_DIFFERS, EXIT_DONE, EXIT_FAILED, EXIT_USAGE, PlaitError


def main(arguments: list[str] | None = None) -> int:
    """Runs one command; returns its exit code (see README). One line on stderr tells what went wrong."""
    # numpy's own threads, where it is not loaded yet: between calls they wait busily beside those of --threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except PlaitError as error:
        if options.debug:
            raise
        print(f"plait: {error}".replace("\n", " "), file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("plait: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return EXIT_DONE
    except Exception as error:
        if options.debug:
            raise
        print(
            f"plait: unexpected {type(error).__name__}: {error}; --debug shows where".replace("\n", " "),
            file=sys.stderr,
        )
        return EXIT_FAILED


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with a command line in one line, as every other error is said."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"plait: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="plait",
        description="Simulate hair, flesh, props, sand and snow of a USD shot: USD in, USD out, no application.",
        epilog="exit codes: 0 done, 2 usage, 3 the simulation failed (frames before it are kept), "
        "4 differs from the reference, 5 bad input, 143 stopped by a signal and resumable",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="versions of plait and what it stands on")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for add in (_sim, _inspect, _compare, _preview, _bench, _pack, _farm, _doctor):
        add(verbs, common)
    return parser


def _verb(verbs: Any, common: argparse.ArgumentParser, name: str, run: Any, help: str) -> argparse.ArgumentParser:
    parser = verbs.add_parser(name, parents=[common], help=help, description=help[0].upper() + help[1:] + ".")
    parser.set_defaults(run=run)
    return parser


def _configuration(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-c", "--config", type=Path, metavar="FILE.toml", help="configuration file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="one setting, e.g. solver.substeps=16"
    )


def _sim(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "sim", _run_sim, "simulate a shot and write its cache")
    parser.add_argument("shot", type=Path, metavar="SHOT.usd")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.usda", help="top layer to write")
    parser.add_argument("-f", "--frames", metavar="1001:1100", help="frames to write; default: the shot's own")
    parser.add_argument("--preroll", type=int, metavar="N", help="frames simulated before the first (24)")
    parser.add_argument("--substeps", type=int, metavar="N", help="substeps a frame (8)")
    _configuration(parser)
    parser.add_argument("--device", metavar="cpu|cuda:0", help="where to solve (cpu)")
    parser.add_argument("--threads", type=int, metavar="N", help="CPU threads (all cores)")
    parser.add_argument("--precision", choices=("float32", "float64"), help="working precision (float32)")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on from the last checkpoint")
    again.add_argument("--overwrite", action="store_true", help="replace an earlier result")
    parser.add_argument("--chunk", type=int, metavar="N", help="frames a cache file (20)")
    parser.add_argument(
        "--skip-unsupported", action="store_true", help="leave prims alone whose physics does not exist yet"
    )
    parser.add_argument("--progress", choices=("rich", "openjd", "none"), default="rich")
    parser.add_argument("--log-format", choices=("text", "json"), default="text")


def _run_sim(options: argparse.Namespace) -> int:
    from plait.pipeline import config, driver, progress

    flags = {
        "preroll": options.preroll,
        "solver.substeps": options.substeps,
        "solver.device": options.device,
        "solver.threads": options.threads,
        "solver.precision": options.precision,
        "output.chunk": options.chunk,
    }
    settings = config.load(options.config, options.set, {key: v for key, v in flags.items() if v is not None})
    shown = progress.make(options.progress, options.log_format)
    try:
        return driver.simulate(
            options.shot,
            options.output,
            settings,
            frames=options.frames,
            resume=options.resume,
            overwrite=options.overwrite,
            skip_unsupported=options.skip_unsupported,
            progress=shown,
        )
    finally:
        shown.close()


def _inspect(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(
        verbs, common, "inspect", _run_inspect, "tell what each prim of a shot will be, and what is skipped"
    )
    parser.add_argument("shot", type=Path, metavar="SHOT.usd")
    _configuration(parser)
    parser.add_argument("--json", action="store_true", help="as JSON")


def _run_inspect(options: argparse.Namespace) -> int:
    from plait.pipeline import config, inspect

    inspect.show(options.shot, config.load(options.config, options.set), as_json=options.json)
    return EXIT_DONE


def _compare(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "compare", _run_compare, "judge a cache against a reference")
    parser.add_argument("reference", type=Path, metavar="REFERENCE.usd")
    parser.add_argument("new", type=Path, metavar="NEW.usd")
    parser.add_argument("--tolerance", type=float, metavar="METRES", help="largest distance allowed")
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write a page with plots and pictures")


def _run_compare(options: argparse.Namespace) -> int:
    from plait.pipeline import compare

    same = compare.show(
        options.reference, options.new, tolerance=options.tolerance, as_json=options.json, report=options.report
    )
    return EXIT_DONE if same else EXIT_DIFFERS


def _preview(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "preview", _run_preview, "render a still or a clip of a cache")
    parser.add_argument("cache", type=Path, metavar="CACHE.usda")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="STILL.png|CLIP.webp")
    parser.add_argument("-f", "--frames", metavar="1001:1100", help="frame of a still, frames of a clip")
    parser.add_argument("--size", default="960x720", metavar="WxH", help="pixels (960x720)")
    parser.add_argument("--camera", metavar="PRIM", help="render through this camera prim")
    parser.add_argument("--core", action="store_true", help="show what is bone within flesh, of a shot or a cache")
    _configuration(parser)


def _run_preview(options: argparse.Namespace) -> int:
    from plait.pipeline import config, preview

    settings = config.load(options.config, options.set)
    preview.render(
        options.cache,
        options.output,
        frames=options.frames,
        size=options.size,
        camera=options.camera,
        core=settings if options.core else None,
    )
    return EXIT_DONE


def _bench(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "bench", _run_bench, "measure run time against error")
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases to run; default: all")
    parser.add_argument("--list", action="store_true", help="name the cases and stop")
    parser.add_argument("--device", default="cpu", metavar="cpu|cuda:0")
    parser.add_argument("--threads", type=int, default=1, metavar="N")
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="plot error against seconds")


def _run_bench(options: argparse.Namespace) -> int:
    from plait.pipeline import bench

    return bench.show(
        options.cases,
        list_only=options.list,
        device=options.device,
        threads=options.threads,
        as_json=options.json,
        plot=options.plot,
    )


def _pack(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "pack", _run_pack, "make one file of a cache")
    parser.add_argument("cache", type=Path, metavar="OUT.usda")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="ONE.usdc")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier file")
    parser.add_argument(
        "--flatten", action="store_true", help="take the shot's own prims in too, not only over it"
    )


def _run_pack(options: argparse.Namespace) -> int:
    from plait.pipeline import pack

    pack.pack(options.cache, options.output, overwrite=options.overwrite, flatten=options.flatten)
    return EXIT_DONE


def _farm(verbs: Any, common: argparse.ArgumentParser) -> None:
    parser = _verb(verbs, common, "farm", _run_farm, "write a job for a render farm, a task a shot")
    parser.add_argument("engine", choices=("openjd",), help="Open Job Description")
    parser.add_argument("shots", nargs="+", type=Path, metavar="SHOT.usd")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="job.yaml")
    parser.add_argument("--results", type=Path, default=Path("."), metavar="DIR", help="where results go")


def _run_farm(options: argparse.Namespace) -> int:
    from plait.pipeline import farm

    farm.write_job(options.shots, options.output, options.results)
    return EXIT_DONE


def _doctor(verbs: Any, common: argparse.ArgumentParser) -> None:
    _verb(verbs, common, "doctor", _run_doctor, "check this machine: versions, devices, drawing, folders")


def _run_doctor(options: argparse.Namespace) -> int:
    from plait.pipeline import doctor

    return EXIT_DONE if doctor.show() else EXIT_FAILED


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from plait.pipeline.provenance import versions

        print("\n".join(f"{name} {text}" for name, text in versions().items()))
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
