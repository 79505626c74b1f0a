import os
import subprocess
import sys
from pathlib import Path


def test_onnxruntime_reports_nothing(tmp_path: Path) -> None:
    """When onnxruntime reports, it first writes an identifier of the device to a file."""
    unset = ('CI', 'ORT_DISABLE_TELEMETRY', 'XDG_CACHE_HOME')
    env = {name: value for name, value in os.environ.items() if name not in unset}
    code = 'import sys, hoid_detector.model.network; sys.exit("onnxruntime" not in sys.modules)'
    subprocess.run([sys.executable, '-c', code], env=env | {'HOME': str(tmp_path)}, check=True)
    assert list(tmp_path.rglob('deviceid')) == []
