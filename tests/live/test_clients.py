"""The clients of examples/clients in their own languages, against a server."""

import json
import shutil
import subprocess

import pytest
from helpers.paths import ROOT
from helpers.scenes import document

from clothfit import load, simulate

pytest.importorskip("tornado")

from clothfit.live.server import Serving

pytestmark = pytest.mark.slow  # starts processes

CLIENTS = ROOT / "examples" / "clients"
MOST_LINES = 200

NODE = """
import { Clothfit } from %(client)s;
const live = new Clothfit(process.argv[2]);
await live.ready;
const start = live.latest();
await live.send("step", { n: 20 });
while (live.latest().number < 20) await new Promise((later) => setTimeout(later, 5));
const { number, positions } = live.latest();
let reason = null;
try { await live.send("dance"); } catch (error) { reason = error.message; }
console.log(JSON.stringify({ first: start.number, number, last: [...positions.slice(-3)], count: positions.length,
                             counts: live.scene.mesh.vertex_counts, reason }));
live.close();
"""

CSHARP = """
using System;
using System.Threading;
static class Program
{
    static void Main(string[] arguments)
    {
        using (var live = new Clothfit.Client(arguments[0]))
        {
            float[] x = null;
            ulong number;
            string json, all = "";
            while (!live.Latest(ref x, out number)) Thread.Sleep(5);
            ulong first = number;
            live.Send("{\\"type\\":\\"step\\",\\"n\\":20,\\"id\\":1}");
            live.Send("{\\"type\\":\\"dance\\",\\"id\\":2}");
            while (number < 20 && live.Error == null)
            {
                Thread.Sleep(5);
                live.Latest(ref x, out number);
            }
            while (!all.Contains("\\"id\\":2") && live.Error == null)
            {
                if (live.Message(out json)) all += json;
                else Thread.Sleep(5);
            }
            var culture = System.Globalization.CultureInfo.InvariantCulture;
            Console.WriteLine("{0} {1} {2} {3} {4}", first, number, x.Length, x[x.Length - 2].ToString("R", culture),
                              all.Contains("there is no message 'dance'"));
        }
    }
}
"""


@pytest.fixture
def serving():
    with Serving(load(document())) as server:
        yield server


def height():
    """How high the last vertex is after 20 steps."""
    return simulate(load(document()), 21).positions[-1, -1, 1]


def printed(*command):
    """What a program prints."""
    done = subprocess.run(command, capture_output=True, check=False, timeout=300)
    assert done.returncode == 0, (done.stdout + done.stderr).decode()
    return done.stdout.decode()


@pytest.mark.parametrize("name", ["clothfit.js", "Clothfit.cs"])
def test_clients_are_short_and_without_packages(name):
    lines = (CLIENTS / name).read_text("utf-8").splitlines()
    assert len(lines) <= MOST_LINES
    used = [line for line in lines if line.startswith(("import ", "using ")) and "System" not in line]
    assert used == []


def test_a_client_in_javascript(serving, tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    known = subprocess.run([node, "-e", "process.exit(typeof WebSocket === 'undefined')"], check=False).returncode == 0
    flags = [] if known else ["--experimental-websocket"]  # of node 20
    program = tmp_path / "program.mjs"
    shutil.copy(CLIENTS / "clothfit.js", tmp_path / "clothfit.mjs")
    program.write_text(NODE % {"client": json.dumps("./clothfit.mjs")}, "utf-8")
    found = json.loads(printed(node, *flags, str(program), serving.address))
    assert (found["first"], found["number"], found["count"], found["counts"]) == (0, 20, 36, [12])
    assert found["last"][1] == pytest.approx(height(), abs=1e-6)  # float32
    assert "there is no message 'dance'" in found["reason"]


def test_a_client_in_csharp(serving, tmp_path):
    compiler, runtime = shutil.which("mcs"), shutil.which("mono")
    if compiler is None or runtime is None:
        pytest.skip("mono is not installed")
    (tmp_path / "program.cs").write_text(CSHARP, "utf-8")
    made = tmp_path / "program.exe"
    printed(compiler, f"-out:{made}", str(CLIENTS / "Clothfit.cs"), str(tmp_path / "program.cs"))
    first, number, count, y, refused = printed(runtime, str(made), serving.address).split()
    assert (first, number, count, refused) == ("0", "20", "36", "True")
    assert float(y) == pytest.approx(height(), abs=1e-6)  # float32
