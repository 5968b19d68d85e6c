"""In every Python process of a campaign: PYTHONPATH says where tiegraph comes from, not the finder of an editable
install, which would come first."""

import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__module__.startswith("_editable")]
