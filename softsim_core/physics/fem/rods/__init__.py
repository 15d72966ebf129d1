r"""Cells of rods: slender bodies whose cross-sections move as wholes, in nodes that have places only.

A cross-section is three nodes on an ellipse about its centre r. They are what moves; r and the directors
d_1, d_2, which begin as the axes of the section with length one, are linear in them:
:math:`x_k = r + a_k d_1 + b_k d_2`. With :math:`(a_k, b_k) = \sqrt2 (i_1 \cos \varphi_k, i_2 \sin \varphi_k)`
at three even angles, and the radii of gyration i_1, i_2 of the section, nodes of one third of its mass each
have its mass, its centre and all its moments of inertia.

A cell has three sections, and r, d_1, d_2 are quadratic in the length s of the unstrained rod. With a dash
for the derivative by s, and :math:`\lambda = |r'|`, its strains are

.. math:: \varepsilon = \lambda - 1, \quad \gamma_i = r' \cdot d_i, \quad
    \kappa_i = r' \cdot d_i' / \lambda, \quad \tau = \tfrac12 (d_1' \cdot d_2 - d_1 \cdot d_2')

taken at two Gauss points, so neither shear nor stretch locks; a fibre at (a, b) of the section is stretched
by :math:`\varepsilon + a \kappa_1 + b \kappa_2`. The directors are held to length one and a right angle, at
the sections, by what stretches these: :math:`\tfrac12 (d_i \cdot d_i - 1)` and :math:`d_1 \cdot d_2`; what
bends a rod changes its sections, too, by the square of a fibre's strain. All are functions of products of two
of these vectors, which are quadratic in the places of the nodes, and turning changes none of them; step,
statics and contact take a rod as any other body.

Sources: Simo 1985, A finite strain beam formulation; Romero and Armero 2002, An objective finite element
approximation of the kinematics of geometrically exact rods; Betsch and Steinmann 2002, Frame-indifferent beam
finite elements based upon the geometrically exact beam theory.

A clamp that gives way is a cell of its own, whose outer section and middle one, A' and A, belong to what
holds the rod, and whose third, B, is the rod's end. With h between sections, :math:`t = (r_A - r_{A'}) / h`
and :math:`g = (r_B - r_A) / h`, its two points have :math:`r', d_i, d_i'` of their own: g, d_i of A, and how
these differ from A' to A; then t, d_i of A, and d_i of B over h, which make of :math:`\kappa_i` and
:math:`\tau` the sines of what B has turned beside A. So B turns about its own centre, and far.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
