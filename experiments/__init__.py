"""What makes the published numbers: results, ablations, figures, tables, benchmark, peers.

Everything here may import the lesson, `support`, `scenes` and `evaluation`; nothing imports it.
"""
