// Python bindings of colliders.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "colliders/arrays.h"
#include "colliders/surface.h"

namespace animtool {

void bind_colliders(nb::module_& m) {
  m.def("build_mesh_tree", &build_mesh_tree, WithoutLock(), "points"_a, "triangles"_a,
        R"(A tree of boxes over triangles ``(T, 3)`` of points ``(P, 3)``, for distances.

Returns ``(triangles, corner_normals, edge_normals, bounds, nodes)``: the triangles in the
order of the tree; the normals that distinguish inside from outside at corners ``(P, 3)`` and
edges ``(T, 3, 3)``, zero on the boundary of an open mesh; the boxes of the nodes ``(M, 6)``; and
the two children of each node, or ``-1 - first`` and a count of triangles ``(M, 2)``.)");

  nb::class_<MeshSurface>(
      m, "MeshSurface",
      R"(Triangles ``(T, 3)`` whose points move from their initial positions ``(P, 3)``.

Its tree is built once, and its boxes are refitted to the points.)")
      .def(nb::init<In<double, 2>, In<std::int32_t, 2>>(), WithoutLock(), "points"_a, "triangles"_a)
      .def("distances", &MeshSurface::distances, WithoutLock(), "positions"_a, "points"_a,
           R"(Signed distances ``(N,)`` of points ``(N, 3)``, negative inside.

The points of the mesh are at ``positions`` ``(P, 3)``.)");

  m.def("collide_particles", &collide_particles, WithoutLock(), "colliders"_a, "before"_a,
        "after"_a, "radii"_a, "begins"_a, "step"_a,
        R"(Resolve the collisions of N particles in a step.

``colliders``: ``kinds`` ``(C, 3)`` (0 plane, 1 sphere, 2 capsule, 3 box, 4 mesh; whether it
is a container; the root node of a mesh), ``sizes`` ``(C, 7)``, ``materials`` ``(C, 4)`` (restitution,
friction, margin, depenetration speed), ``poses`` ``(C, 2, 7)`` at both ends of the step
(origin, quaternion), then the points and the arrays of `build_mesh_tree` of all meshes.
States ``(2, N, 3)`` are positions and velocities at both ends of the ``step``; particles exist
from the time ``begins`` ``(N,)`` in the step.

Returns ``(state, touches, normals)``: ``(2, N, 3)``; the last collider in contact or -1, and
the kind of contact (0 none, 1 bounced, 2 rests, 3 unresolved) ``(N, 2)``; outward directions
``(N, 3)``.)");

  m.def("sample_colliders", &sample_colliders, WithoutLock(), "colliders"_a, "points"_a,
        "fraction"_a, "step"_a,
        R"(Sample C colliders at N points, at a ``fraction`` of a step.

Returns ``(distances, normals, velocities)``: ``(C, N)`` minus the margins, negative inside;
outward normals and velocities of the surfaces ``(C, N, 3)``.)");
}

}  // namespace animtool
