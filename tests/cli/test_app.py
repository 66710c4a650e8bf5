"""The command `cddf` as a whole: help, usage, exit codes, and every failure in one line that names what to do."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from places import DATA

from cddf_jax.cli import app as cli

PAPER, LOAD_CELLS, PULLEY = (
    str(DATA / name) for name in ("smooth_sil_940.toml", "load_cells_simulated.csv", "pulley_simulated.csv")
)
PULL = ("-t", "75 N")
COMMANDS = ("solve", "trace", "sweep", "fit", "design", "plan", "reproduce", "explore")


@pytest.mark.parametrize("arguments", [(), *((command,) for command in COMMANDS)])
def test_help(cddf_command, arguments):
    """Every command says how it is used, with an example."""
    code, out, err = cddf_command(*arguments, "--help")
    assert (code, err) == (0, "")
    assert "Usage: " in out
    assert "--help" in out
    assert all(name in out for name in arguments or COMMANDS)
    assert not arguments or "Example: cddf" in out


def test_help_shows_units_in_brackets(cddf_command):
    """What an option's text says of columns and tables, [mm] and [over], is not taken for markup."""
    assert all(text in cddf_command("trace", "--help")[1] for text in ("[N]", "[mm]", "[deg]"))
    assert "[over]" in cddf_command("sweep", "--help")[1]


def test_help_imports_nothing_heavy():
    script = (
        "import sys; sys.argv = ['cddf', 'sweep', '--help']\n"
        "from cddf_jax.cli.app import main\n"
        "try: main()\n"
        "except SystemExit as ended: assert ended.code == 0\n"
        "heavy = {'jax', 'jaxlib', 'equinox', 'optimistix', 'scipy', 'numpy', 'matplotlib', 'pint', 'xarray'}\n"
        "heavy |= {'zarr', 'pandas'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "Missing command. Try --help."),
        (("solve", PAPER), "Missing option '--base-tension' / '-t'"),
        (("solve", PAPER, *PULL, "--bogus"), "No such option: --bogus"),
        (("solve", PAPER, *PULL, "--nodes", "3"), "Invalid value for '--nodes'"),
        (("fit", PAPER, PULLEY, "--noise", "pulling_tension=0 N"), "sigma of pulley_simulated.csv: pulling_tension mu"),
        (("reproduce", PAPER, LOAD_CELLS, "--column", "a=trial"), "load_cells_simulated.csv: no column 'a'"),
        (("reproduce", PAPER, PULLEY), "pulley_simulated.csv: the column tip_tension is missing"),
    ],
)
def test_wrong_usage(fails, arguments, message):
    assert fails(*arguments).startswith(message)


def test_a_wrong_manipulator(fails):
    text = Path(PAPER).read_text().replace("youngs_modulus", "young_modulus")
    said = fails("solve", "robot.toml", *PULL, files={"robot.toml": text})
    assert said == "robot.toml: unknown key 'young_modulus'; did you mean youngs_modulus?"


def test_files_that_are_not_there(fails):
    remedy = "cannot be read (No such file or directory); check the path"
    assert fails("solve", "none.toml", *PULL) == f"none.toml: {remedy}"
    assert fails("fit", PAPER, PULLEY, "none.csv") == f"none.csv: {remedy}"
    assert fails("fit", PAPER, ".").startswith(".: cannot be read (Is a directory)")


def test_a_wrong_table(fails):
    table = "base_tension [N],tip_tension [N]\n5,4.8\n10,9.O1\n"
    said = fails("fit", PAPER, PULLEY, "bench.csv", "--out", "folder", files={"bench.csv": table})
    assert said.startswith("bench.csv: row 3, column tip_tension: '9.O1' is not a number")


def test_tables_that_do_not_fit_the_manipulator(fails, two_tendons):
    said = fails("fit", two_tendons, LOAD_CELLS)
    assert said.endswith("no column 'base_tension_2'; a manipulator of 2 tendons needs it; add it, or displacement_2")
    table = "base_tension [N],base_tension_2 [N],tip_tension [N]\n5,5,4.8\n"
    said = fails("fit", PAPER, "bench.csv", files={"bench.csv": table})
    assert said.startswith("bench.csv: column 'base_tension_2', but the manipulator has 1 tendon(s)")
    assert fails("reproduce", two_tendons, LOAD_CELLS).startswith("the paper's manipulator has one tendon")


@pytest.mark.parametrize(
    "command",
    [
        ("solve", PAPER, *PULL),
        ("trace", PAPER, "--path", "0 N, 5 N"),
        ("design", "task.toml"),
        ("fit", PAPER, PULLEY),
        ("plan", PAPER),
        ("reproduce", PAPER, LOAD_CELLS),
    ],
)
def test_out_that_cannot_be_written_is_refused_before_the_work(fails, monkeypatch, command):
    monkeypatch.setattr("cddf_jax.files.manipulator_file.read_robot_file", None)  # it is not even read
    said = fails(*command, "--out", "taken/below", files={"taken": "kept"})
    assert said == "--out: taken: Not a directory; choose another place"


def full(*arguments, **options):
    """As the system says it."""
    raise OSError(28, "No space left on device")


def test_a_full_disk_is_found_before_the_work(fails, monkeypatch):
    monkeypatch.setattr("cddf_jax.batch.drafts.TemporaryFile", full)
    said = fails("solve", PAPER, *PULL, "--out", "new/below")
    assert said == "--out: .: No space left on device; choose another place"


def test_a_disk_that_fills_up_leaves_the_answer_on_standard_output(cddf_command, monkeypatch, tmp_path):
    """The answer is that without `--out`; one line says what was not written, and no half of it stays."""
    _, answer, _ = cddf_command("solve", PAPER, *PULL, "--json")
    monkeypatch.setattr("cddf_jax.figures.render", lambda *_: {})
    monkeypatch.setattr(Path, "write_bytes", full)  # after the trial
    out = tmp_path / "new" / "below"
    code, text, error = cddf_command("solve", PAPER, *PULL, "--json", "--out", out)
    assert (code, json.loads(text)) == (2, json.loads(answer))
    assert error == f"error: not written: {out / 'solve.json'}: No space left on device; choose another place\n"
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_ctrl_c_is_one_line(fails, monkeypatch):
    def interrupted(path):
        raise KeyboardInterrupt

    monkeypatch.setattr("cddf_jax.files.manipulator_file.read_robot_file", interrupted)
    assert fails("solve", PAPER, *PULL, "--out", "new/below", code=130) == "interrupted; nothing was written"


def test_a_bug_of_ours_is_not_hidden(monkeypatch):
    def broken(path):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("cddf_jax.files.manipulator_file.read_robot_file", broken)
    monkeypatch.setattr(sys, "argv", ["cddf", "solve", PAPER, *PULL])
    with pytest.raises(ZeroDivisionError, match="a bug"):
        cli.main()
