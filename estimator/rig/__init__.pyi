from .recent_poses import RecentPoses as RecentPoses
from .topic import open_topic as open_topic
