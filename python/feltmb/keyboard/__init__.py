"""A keyboard of 88 keys, key by key, and ground truth for sensors at its hammers and keys."""

from feltmb.keyboard.balance import Balance, analyze
from feltmb.keyboard.keys import Keyboard, note_name, read_keyboard
from feltmb.keyboard.note import action_of_key
from feltmb.keyboard.work import list_of_work

__all__ = [
    "Balance",
    "Keyboard",
    "action_of_key",
    "analyze",
    "list_of_work",
    "note_name",
    "read_keyboard",
]
