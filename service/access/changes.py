"""Changes that other processes make in the data folder: a running server heeds them within a second."""

import asyncio
import logging
import sqlite3

from service.access.keys import Keys
from service.jobs.model_cache import Models
from service.storage.database import Database

_PERIOD = 0.5  # seconds between looks; one costs some microseconds

logger = logging.getLogger(__name__)


async def follow(database: Database, keys: Keys, models: Models) -> None:
    """Read the keys again, and forget the models, whenever another process has written; until it is cancelled."""
    changed = False
    while True:
        await asyncio.sleep(_PERIOD)
        try:
            # In threads that uploads and evaluations do not use: a key has to be refused under load too.
            changed = await asyncio.to_thread(database.changed_by_others) or changed
            if changed:
                for key in await asyncio.to_thread(keys.load, database):
                    key.revoked.set()
                models.forget_all()
                changed = False
        except sqlite3.Error:
            logger.exception("what other processes have written could not be read; trying again")
