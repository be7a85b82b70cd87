"""How recordings and models show themselves: their plots and, in a notebook, their tables.

Read `plots`, then `html`. The methods of the objects, such as `Recording.plot`, call these; figures of the paper and of
an identification are in rooms of their own.
"""
