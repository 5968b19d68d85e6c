"""A fork server: tiegraph and its libraries are imported once, then every command line runs in a forked child.

Reads one JSON request a line on standard input: {"argv", "cwd", "log", "mark", "file_bytes", "memory_bytes",
"copies"}; answers {"pid"} when the child runs and {"status"} (as of waitpid) when it has ended. The child has a
session of its own, leaves through the interpreter's own end, and its helpers start like those of
`python -m tiegraph.cli.main`. With {"module"} it is `python -m module argv` in their place, is not waited for, and the
next request may come at once.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import pkgutil
import resource
import shutil
import signal
import sys

_PR_SET_PDEATHSIG = 1
_KEPT = []  # the module this runs in, once another one has taken its name


def preload() -> None:
    """Import all of tiegraph and, with it, every library it uses, and read a command line, whose options every command
    builds validators for: more work than a stage of a small survey."""
    import tiegraph

    gc.disable()  # nothing of what is loaded is garbage
    for module in pkgutil.walk_packages(tiegraph.__path__, "tiegraph."):
        try:
            importlib.import_module(module.name)
        except ImportError:  # an extra that is not installed
            continue
    importlib.import_module("tiegraph.cli.run").preparsed(["images"])
    gc.freeze()  # a child's collector would touch, and so copy, every page of it
    gc.enable()


def end_with_parent() -> None:
    """The kernel ends this process when the one that started it has gone (Linux): a campaign that is stopped leaves
    nothing behind."""
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    except (AttributeError, OSError):
        pass


def become(request: dict) -> int:
    """Turn the forked child into `tiegraph <argv>`, or into another program; its exit code."""
    end_with_parent()
    os.setsid()
    log = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    null = os.open(os.devnull, os.O_RDONLY)
    for target, source in ((0, null), (1, log), (2, log)):
        os.dup2(source, target)
    os.chdir(request["cwd"])
    os.environ["CAMPAIGN_CASE"] = request["mark"]
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for limit, value in (("RLIMIT_FSIZE", request.get("file_bytes")), ("RLIMIT_DATA", request.get("memory_bytes"))):
        if value:
            resource.setrlimit(getattr(resource, limit), (value, value))
    for name in ("SIGHUP", "SIGTERM", "SIGQUIT", "SIGUSR1"):  # whoever started the campaign may have them ignored
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    name = request.get("module", "tiegraph.cli.main")
    main = importlib.import_module(name)
    main.__spec__ = importlib.util.find_spec(name)
    _KEPT.append(sys.modules["__main__"])
    sys.modules["__main__"] = main
    if "module" in request:
        sys.argv = [str(main.__file__), *request["argv"]]
        return main.main()
    from tiegraph import forking

    if request.get("copies"):
        copy_after_stages(request["copies"])
    forking.allow()  # this process is that of `tiegraph <argv>` alone
    sys.argv = ["tiegraph", *request["argv"]]
    return main.main(request["argv"])


def copy_after_stages(to: str) -> None:
    """Copy the run folder as it is after a stage, when the next one is to begin."""
    from tiegraph.project import run as stages

    real, done = stages._run_one, []

    def run_one(stage, key, run, artefacts):
        for name in done[-1:]:
            shutil.copytree(run.folder, os.path.join(to, name), symlinks=True)
        real(stage, key, run, artefacts)
        done.append(stage.name)

    stages._run_one = run_one


def reap() -> None:
    """Let go of what was not waited for and has ended."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def serve() -> int:
    """Answer requests until standard input ends."""
    end_with_parent()
    preload()
    sys.stdout.write(json.dumps({"ready": os.getpid()}) + "\n")
    sys.stdout.flush()
    for line in iter(sys.stdin.readline, ""):
        reap()
        request = json.loads(line)
        request["argv"] = [os.fsdecode(bytes.fromhex(a)) for a in request["argv"]]
        if other := request.get("module"):
            importlib.import_module(other)
        pid = os.fork()
        if pid == 0:
            return become(request)
        sys.stdout.write(json.dumps({"pid": pid}) + "\n")
        sys.stdout.flush()
        if other:
            continue
        _, status = os.waitpid(pid, 0)
        sys.stdout.write(json.dumps({"status": status}) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(serve())
