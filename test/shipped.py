"""What is shipped in config/."""

from pathlib import Path

CONFIG = Path(__file__).resolve().parent.parent / "config"
# diagnostics.yaml is for diagnostic_aggregator
PARAMETER_FILES = sorted(file for file in CONFIG.glob("*.yaml") if file.stem != "diagnostics")
