from fracsys import checks as checks
from fracsys import errors as errors
from fracsys._calculus import derivative as derivative
from fracsys._calculus import integral as integral
from fracsys._control import from_control as from_control
from fracsys._control import to_control as to_control
from fracsys._fractional import FractionalTransferFunction as FractionalTransferFunction
from fracsys._fractional import s as s
from fracsys._margins import Margins as Margins
from fracsys._margins import margins as margins
from fracsys._mittag_leffler import mittag_leffler as mittag_leffler
from fracsys._modes import DiscreteModes as DiscreteModes
from fracsys._rational import RationalApproximation as RationalApproximation
from fracsys._rational import approximate as approximate
from fracsys._response import TimeResponse as TimeResponse
from fracsys._response import discrete_modes as discrete_modes
from fracsys._response import impulse_response as impulse_response
from fracsys._response import step_response as step_response
from fracsys._response import time_response as time_response
from fracsys._stability import StabilityVerdict as StabilityVerdict
from fracsys._stability import is_stable as is_stable
from fracsys._stability import poles as poles
from fracsys._terms import Term as Term

__all__: list[str]
