"""The daemon as a process of its own on a prepared configuration with simulated buses: `page_daemon.py CONFIG`."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from edge_daemon.rig.i2c_face import open_bus
from edge_daemon.service.daemon import Daemon


async def main() -> None:
    await Daemon(Path(sys.argv[1]), i2c_bus=lambda name: open_bus(str(name))).run()


asyncio.run(main())
