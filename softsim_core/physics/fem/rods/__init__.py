r"""Cells of rods: slender bodies with rigid-like cross-sections, on nodes that have positions only.

A cross-section has three nodes on an ellipse about its centre r. The nodes are the unknowns; r and the
directors d_1, d_2, which start as the axes of the section with length one, are linear in them:
:math:`x_k = r + a_k d_1 + b_k d_2`. With :math:`(a_k, b_k) = \sqrt2 (i_1 \cos \varphi_k, i_2 \sin \varphi_k)`
at three equally spaced angles, and the radii of gyration i_1, i_2 of the section, three nodes of one third of
its mass each have its mass, its centre and all its moments of inertia.

A cell has three sections, and r, d_1, d_2 are quadratic in the length s of the unstrained rod. With a prime
for the derivative by s, and :math:`\lambda = |r'|`, its strains are

.. math:: \varepsilon = \lambda - 1, \quad \gamma_i = r' \cdot d_i, \quad
    \kappa_i = r' \cdot d_i' / \lambda, \quad \tau = \tfrac12 (d_1' \cdot d_2 - d_1 \cdot d_2')

evaluated at two Gauss points, so that neither shear nor stretch locks. A fibre at (a, b) of the section is
stretched by :math:`\varepsilon + a \kappa_1 + b \kappa_2`. At the sections, the directors are constrained to
length one and a right angle by a stiffness against :math:`\tfrac12 (d_i \cdot d_i - 1)` and
:math:`d_1 \cdot d_2`; bending also changes the sections, by the square of a fibre's strain. All strains are
functions of products of two of these vectors. The products are quadratic in the node positions and invariant
under rotation, so step, statics and contact treat a rod like any other body.

Sources: Simo 1985, A finite strain beam formulation; Romero and Armero 2002, An objective finite element
approximation of the kinematics of geometrically exact rods; Betsch and Steinmann 2002, Frame-indifferent beam
finite elements based upon the geometrically exact beam theory.

A compliant clamp is a cell of its own. Its outer and middle sections, A' and A, belong to the support of the
rod, and its third section, B, is the rod's end. With h between sections, :math:`t = (r_A - r_{A'}) / h` and
:math:`g = (r_B - r_A) / h`, its two points have their own :math:`r', d_i, d_i'`: at the first point g, d_i of
A, and the difference of the d_i from A' to A over h; at the second point t, d_i of A, and d_i of B over h,
which make :math:`\kappa_i` and :math:`\tau` the sines of the rotation of B relative to A. B therefore turns
about its own centre, also through large angles.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
