"""The program beside Blender: calls one after the other, with progress and cancel, while Blender goes on."""

import json
import os
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

PATIENCE = 0.3
"""Seconds between two looks."""

DONE, SHORT, INTERRUPTED = 0, 5, 130
"""Exit codes with a result: all went well; a fit ended without reaching its tolerance; it was cancelled."""


class Failed(Exception):
    """What the user should know."""


def program(line):
    """A line such as `clothfit` or `/path/python -m clothfit` as the beginning of a call. Raises Failed."""
    words = [line.strip()] if os.path.isfile(line.strip()) else shlex.split(line, posix=os.name == "posix")
    if not words or shutil.which(words[0]) is None:
        raise Failed(f"the program {line!r} was not found; say where it is in the preferences of the add-on Clothfit")
    return words


class Job:
    """Calls of the program; `then` is called with the path of the result after the last one."""

    def __init__(self, words, calls, result, then):
        self.words, self.calls, self.result, self.then = words, list(calls), str(result), then
        self.log = Path(tempfile.mkstemp(prefix="clothfit-", suffix=".jsonl")[1])
        self.said = tempfile.TemporaryFile()  # noqa: SIM115 (for the life of the job)
        self.progress, self.message, self.failed, self.cancelled = "starting", "", False, False
        self.process = None
        self.call = None
        self._next()

    def cancel(self):
        """End the call: a fit writes the best so far when its input is closed."""
        self.cancelled, self.progress = True, "ending; the best so far is written"
        self.process.stdin.close()

    def poll(self):
        """Look how far it is; whether it goes on."""
        self._read_log()
        code = self.process.poll()
        if code is None:
            return True
        fit = self.call[0] == "estimate"
        if code != DONE and not (fit and code in (SHORT, INTERRUPTED) and self.written()):
            return self._end(self._fault() or f"clothfit ended with exit code {code}", failed=True)
        if fit:
            self.message = self._last_words()
        if self.calls:
            self._next()
            return True
        return self._end(self.message)

    def written(self):
        """Whether the fit of this job has written its result."""
        return bool((self._summary() or {}).get("output"))

    def _next(self):
        self.call = self.calls.pop(0)
        if self.call[0] == "estimate":
            self.call += ["--log", str(self.log), "--end-with-input", "--json"]
        self.said.seek(0)
        self.said.truncate()
        environment = {**os.environ, "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"}
        environment.pop("PYTHONHOME", None)  # Blender's
        flags = subprocess.CREATE_NO_WINDOW if os.name == "nt" else 0
        try:
            self.process = subprocess.Popen(
                [*self.words, *self.call], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self.said,
                env=environment, creationflags=flags,
            )  # fmt: skip
        except OSError as error:
            raise Failed(f"{self.words[0]}: {error.strerror}") from error

    def _end(self, message, failed=False):
        self.message, self.failed = message, failed and not self.cancelled
        if failed and self.cancelled:
            self.message = "cancelled before there was a result"
        if not self.process.stdin.closed:
            self.process.stdin.close()
        self.log.unlink(missing_ok=True)
        self.said.close()
        if not failed:
            self.then(self.result)
        return False

    def _lines(self):
        self.said.seek(0)
        return [line.strip() for line in self.said.read().decode("utf-8", "replace").splitlines() if line.strip()]

    def _fault(self):
        lines = self._lines()
        errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
        return (errors or lines or [""])[-1]

    def _last_words(self):
        summary = self._summary()
        words = f"{summary['status']}: RMSE {1000 * summary['rmse']:.3g} mm"
        return f"{words}, {100 * summary['relative_rmse']:.2g} % of the way" if summary.get("relative_rmse") else words

    def _entries(self):
        text = self.log.read_text(encoding="utf-8") if self.log.exists() else ""
        return [json.loads(line) for line in text.split("\n")[:-1] if line]

    def _summary(self):
        entries = self._entries()
        return entries[-1].get("summary") if entries else None

    def _read_log(self):
        if self.call[0] != "estimate" or self.cancelled:
            return
        entries = [entry for entry in self._entries() if entry.get("rmse") is not None]
        if entries:
            last = entries[-1]
            frames = f"{last['window']} of {last['frames']} frames"
            self.progress = f"{frames}, RMSE {1000 * last['rmse']:.3g} mm, {last['seconds']:.0f} s"
