"""The package as it is released: its public names; built, installed elsewhere, and used without the checkout."""

import inspect
import os
import pickle
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

RESULTS = (mpsim.Tuned, measure.Measure)
"""Public classes, beside the rest of those of `measure`, that users are given and do not make or call with names."""


def doors():
    """All public functions, constructors and methods, with what stands for `self`; by name."""
    for module in (mpsim, measure):
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                yield name, thing, ()
            elif inspect.isclass(thing) and not issubclass(thing, (*RESULTS, BaseException)):
                if module is mpsim and thing is not mpsim.State:  # whose other names are columns
                    yield name, thing, ()
                for own, method in vars(thing).items():
                    if own.startswith("_"):
                        continue
                    if inspect.isfunction(method):
                        yield f"{name}.{own}", method, (None,)
                    elif isinstance(method, classmethod | staticmethod):
                        yield f"{name}.{own}", getattr(thing, own), ()


DOORS = [(name, call, own) for name, call, own in doors() if not name.endswith(".capsules")]  # of obstacles: internal


def test_each_public_door_answers_a_name_that_it_does_not_have():
    assert len(DOORS) > 100
    assert not hasattr(mpsim, "nothing")
    with mpsim.Simulation(mpsim.Scene.load("cradle"), mpsim.Settings(method="naive")) as sim:
        for name, call, own in DOORS:
            with pytest.raises(mpsim.InputError, match="nonsense") as caught:
                call(*([sim] if own and name.startswith("Simulation.") else own), nonsense=1)
            assert isinstance(caught.value, TypeError) or name == "Simulation.change", "as Python raises it"


def test_an_error_of_a_function_that_is_given_is_no_wrong_call_and_public_functions_can_be_pickled():
    def wrong(done, frames):
        raise TypeError("mine")

    with (
        mpsim.Simulation(mpsim.Scene.load("cradle"), mpsim.Settings(method="naive")) as sim,
        pytest.raises(TypeError, match=r"^mine$"),
    ):
        sim.run(frames=2, progress=wrong)
    for function in (measure.temperature, mpsim.tune, mpsim.draw):
        assert pickle.loads(pickle.dumps(function)) is function


TOP = Path(__file__).parents[2]

SMOKE = """
import mpsim, sys
assert mpsim.__file__.startswith(sys.prefix), mpsim.__file__
scene = mpsim.Scene.load("gas")
digests = set()
for workers in (1, 2):
    with mpsim.Simulation(scene, mpsim.Settings(method="parallel", workers=workers)) as sim:
        sim.run(frames=10)
        digests.add(sim.digest())
assert len(digests) == 1, digests
mpsim.animate(scene, None, "gas.gif", frames=2, progress=False)
print(mpsim.__version__, sim.frame)
"""


def run(*command: str | Path, folder: Path) -> str:
    """Output of a command that knows nothing of the checkout."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(word) for word in command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the source distribution, and the wheel that was built from it."""
    out = tmp_path_factory.mktemp("built")
    run(sys.executable, "-m", "build", "--outdir", out, TOP, folder=out)
    return out


@pytest.fixture(scope="module")
def programs(built, tmp_path_factory) -> Path:
    """Programs of a fresh environment with the wheel; what mpsim depends on is that of this one."""
    folder = tmp_path_factory.mktemp("installed") / "environment"
    venv.create(folder, symlinks=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (wheel,) = built.glob("*.whl")
    python = folder / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", wheel, folder=built)
    return python.parent


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_wheel_holds_what_it_needs_and_no_more(built):
    (wheel,) = built.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    scenes = {path.name for path in (TOP / "mpsim" / "scene" / "named").glob("*.toml")}
    assert {Path(name).name for name in names if name.endswith(".toml")} == scenes
    assert {"mpsim/py.typed", "mpsim/output/mpsim.mplstyle", "mpsim/kernels/frame/stepping.py"} <= set(names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"mpsim"}
    (source,) = built.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        assert any(name.endswith("/README.md") for name in archive.getnames())


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_installed_wheel_and_its_command_run(programs, tmp_path):
    assert run(programs / "python", "-c", SMOKE, folder=tmp_path) == f"{mpsim.__version__} 10\n"
    assert (tmp_path / "gas.gif").stat().st_size > 1000
    listed = run(programs / "mpsim", "scenes", folder=tmp_path)
    assert len(listed.splitlines()) == len(list((TOP / "mpsim" / "scene" / "named").glob("*.toml")))
    assert "packing 0.4" in run(programs / "mpsim", "show", "gas", folder=tmp_path)


@pytest.mark.slow
def test_what_takes_long_to_import_waits_until_it_is_needed():
    code = "import sys, mpsim; assert not {'matplotlib', 'pandas'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
