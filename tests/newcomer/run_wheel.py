# run_wheel.py BUILD VERSION PROGRAM: unpacks the wheel of a build as pip does, and runs a program with it.
import glob
import os
import subprocess
import sys
import tempfile
import zipfile

build, version, program = sys.argv[1:]
program = os.path.abspath(program)
(wheel,) = glob.glob(f"{build}/taut-{version}-*.whl")
with tempfile.TemporaryDirectory() as folder:
    zipfile.ZipFile(wheel).extractall(folder)
    environment = {**os.environ, "PYTHONPATH": folder}
    found = subprocess.run([sys.executable, "-c", "import importlib.metadata as m; print(m.version('taut'))"], env=environment,
                           capture_output=True, text=True, check=True).stdout.strip()
    assert found == version, found
    subprocess.run([sys.executable, program], env=environment, cwd=folder, check=True)
