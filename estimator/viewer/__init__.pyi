from .recording import Recording as Recording
from .recording import check_recording_path as check_recording_path
from .recording import record_stack as record_stack
from .recording import recording_of as recording_of
