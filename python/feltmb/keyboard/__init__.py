"""A keyboard of 88 keys, key by key, and ground truth for sensors at its hammers and keys."""

from feltmb.keyboard.balance import Balance, analyze
from feltmb.keyboard.keys import Keyboard, note_name, read_keyboard
from feltmb.keyboard.midi import play, read_midi, write_midi
from feltmb.keyboard.note import action_of_key, touch_of_keys
from feltmb.keyboard.scoring import load_algorithm, score
from feltmb.keyboard.sensor import Sensor, load_sensor
from feltmb.keyboard.strokes import labeled_strokes, read_set, sensed, write_set
from feltmb.keyboard.velocity import VelocityCurve
from feltmb.keyboard.work import after_work, list_of_work

__all__ = [
    "Balance",
    "Keyboard",
    "Sensor",
    "VelocityCurve",
    "action_of_key",
    "after_work",
    "analyze",
    "labeled_strokes",
    "list_of_work",
    "load_algorithm",
    "load_sensor",
    "note_name",
    "play",
    "read_keyboard",
    "read_midi",
    "read_set",
    "score",
    "sensed",
    "touch_of_keys",
    "write_midi",
    "write_set",
]
