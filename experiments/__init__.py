"""What makes the published numbers: results, ablations, figures, tables, benchmark, peers.

Everything here may import the lesson, `support`, `scenes` and `evaluation`; nothing imports it.
"""

import scenes  # first: it checks that no file of somebody else's stands in for one of ours
