from fraclink.logs._diagnosis import diagnose as diagnose
from fraclink.logs._start import Start as Start
from fraclink.logs._start import start as start

__all__: list[str]
