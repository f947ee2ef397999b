from fraclink.logs._diagnosis import diagnose as diagnose
from fraclink.logs._match import Match as Match
from fraclink.logs._match import match as match
from fraclink.logs._questions import Guess as Guess
from fraclink.logs._questions import Question as Question
from fraclink.logs._start import Start as Start
from fraclink.logs._start import start as start

__all__: list[str]
