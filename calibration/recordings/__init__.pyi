from .trials import LogBook as LogBook
from .trials import Recording as Recording
from .trials import is_stack as is_stack
from .trials import read_recording as read_recording
from .trials import usual_exposure as usual_exposure
from .withdrawals import withdrawal as withdrawal
