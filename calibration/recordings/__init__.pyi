from .trials import LogBook as LogBook
from .trials import Recording as Recording
from .trials import is_stack as is_stack
from .trials import read_recording as read_recording
from .withdrawals import withdrawal as withdrawal
