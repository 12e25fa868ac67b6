// Meshes as particles of springs meet them.
#include "springs/meshes.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

using collide::Mesh;
using collide::Nearest;
using collide::Vec;
using collide::load;

MeshPatches::Found MeshPatches::look(const Mesh& mesh, std::int32_t root, std::size_t n,
                                     Vec p, const MeshWay& gone, double kept, bool bound) {
  Patch& patch = patches_[n];
  const double went = length(p - patch.at - (gone.drift - patch.gone.drift)) +
                      std::abs(gone.spread - patch.gone.spread);
  if (!(went <= patch.slack)) {
    patch.at = p;
    patch.gone = gone;
    return gather(patch, mesh, root, p, kept, bound);
  }
  if (patch.count == 0) return {{patch.distance - went, {0, 1, 0}}, -1};
  const Nearest best = nearest(patch, mesh, p, went);
  // Of what is so far that its square is no number.
  if (best.triangle < 0) return {{collide::FAR, {0, 1, 0}}, -1};
  return {collide::sample_nearest(mesh, best, p), best.triangle};
}

Nearest MeshPatches::nearest(const Patch& patch, const Mesh& mesh, Vec p, double went) const {
  Nearest best;
  const Candidates& candidates = candidates_[static_cast<std::size_t>(patch.place)];
  double enough = collide::FAR;
  for (int k = 0; k < patch.count && candidates[k].distance <= enough; ++k) {
    const Nearest found = collide::nearest_of_triangle(mesh, candidates[k].triangle, p);
    if (!collide::nearer(found, best)) continue;
    best = found;
    enough = std::sqrt(best.squared) + went + collide::TOUCH;
  }
  return best;
}

void MeshPatches::forget() {
  for (Patch& patch : patches_) patch.slack = -1;
}

MeshPatches::Found MeshPatches::gather(Patch& patch, const Mesh& mesh, std::int32_t root,
                                       Vec p, double kept, bool bound) {
  patch.count = 0;
  if (bound) {
    patch.distance = std::sqrt(collide::squared_to_box(p, mesh.bounds + 6 * root));
    patch.slack = (patch.distance - kept) / 2;
    if (patch.slack > patch.fine) return {{patch.distance, {0, 1, 0}}, -1};
  }
  const Nearest near = collide::nearest_on_mesh(mesh, root, p, collide::FAR);
  patch.slack = -1;
  if (near.triangle < 0) return {{collide::FAR, {0, 1, 0}}, -1};
  const collide::Sample found = collide::sample_nearest(mesh, near, p);
  const double beyond = found.distance - kept;
  patch.distance = std::sqrt(near.squared);
  if (bound && beyond > 2 * patch.fine)
    patch.slack = beyond / 2;
  else
    collect(patch, mesh, root, p);
  return {found, near.triangle};
}

void MeshPatches::collect(Patch& patch, const Mesh& mesh, std::int32_t root, Vec p) {
  if (patch.place < 0) {
    patch.place = static_cast<std::int32_t>(candidates_.size());
    candidates_.emplace_back();
  }
  Candidates& candidates = candidates_[static_cast<std::size_t>(patch.place)];
  const double reach = patch.distance + 2 * patch.fine, squared = reach * reach;
  int count = 0;
  collide::visit_triangles(mesh, root, p, squared, [&](std::int32_t t) {
    if (count > MOST) return -1.0;
    const Nearest found = collide::nearest_of_triangle(mesh, t, p);
    if (!(found.squared <= squared)) return squared;
    if (count < MOST) candidates[count] = {std::sqrt(found.squared), t};
    return ++count > MOST ? -1.0 : squared;
  });
  if (count > MOST) {
    patch.fine /= 2;
    return;
  }
  std::sort(candidates.begin(), candidates.begin() + count,
            [](const Candidate& a, const Candidate& b) {
              if (a.distance != b.distance) return a.distance < b.distance;
              return a.triangle < b.triangle;
            });
  patch.count = count;
  patch.slack = patch.fine;
  if (4 * count < MOST) patch.fine *= 1.5;
}

// Cells that a knot lasts, at most.
constexpr std::int64_t MOST_LASTING = std::int64_t{1} << 40;

MovingSurface::MovingSurface(const SpringSurface& surface, std::int64_t cells)
    : surface_(std::get<0>(surface)),
      points_(std::get<1>(surface)),
      numbers_(std::get<2>(surface)),
      lasts_(std::get<3>(surface)),
      first_(std::get<4>(surface)) {
  if (!surface_) check::refuse("colliders.surfaces", "a surface is None");
  check::between("colliders.surfaces", lasts_, 1, MOST_LASTING);
  check::between("colliders.surfaces", first_, 0, lasts_ - 1);
  const std::int64_t knots = (first_ + cells + lasts_ - 1) / lasts_ + 1;
  check::numbers("colliders.surfaces", points_, {static_cast<std::size_t>(knots), surface_->points(), 3});
  check::finite("colliders.surfaces", numbers_.data(), numbers_.size());
  ways_.resize(3 * surface_->points());
  surface_->fit(points_.data(), points_.data(), bounds_);
  if (bounds_.empty()) check::refuse("colliders.surfaces", "a surface has no triangle");
}

bool MovingSurface::enter(std::int64_t cell, double length) {
  const std::int64_t knot = (first_ + cell) / lasts_, over = (first_ + cell) % lasts_;
  begun_ = static_cast<double>(over) / static_cast<double>(lasts_);
  if (begin_ && knot == last_) return true;
  const bool follows = begin_ && knot == last_ + 1, begins = !begin_;
  if (follows) {
    before_.drift = before_.drift + whole_.drift;
    before_.spread += whole_.spread;
  }
  last_ = knot;
  const std::size_t row = ways_.size();
  const double* begin = points_.data() + static_cast<std::size_t>(knot) * row;
  const double* end = begin + row;
  const bool stays = follows && travel_ == 0 && std::equal(begin, end, end);
  begin_ = begin;
  if (stays) return true;
  measure(begin, end);
  const bool jumps = travel_ > numbers_[4] * length * static_cast<double>(lasts_);
  if (jumps) {
    // What is put elsewhere is there from the beginning.
    begin_ = end;
    measure(end, end);
  }
  surface_->fit(begin_, end, bounds_);
  return (begins || follows) && !jumps;
}

void MovingSurface::measure(const double* begin, const double* end) {
  const std::size_t count = ways_.size() / 3;
  Vec sum;
  travel_ = 0;
  for (std::size_t p = 0; p < 3 * count; p += 3) {
    const Vec way = load(end + p) - load(begin + p);
    store(way, ways_.data() + p);
    sum = sum + way;
    travel_ = std::max(travel_, length(way));
  }
  whole_.drift = sum * (1 / static_cast<double>(count));
  whole_.spread = 0;
  for (std::size_t p = 0; travel_ > 0 && p < 3 * count; p += 3)
    whole_.spread = std::max(whole_.spread, length(load(ways_.data() + p) - whole_.drift));
}

collide::Collider MovingSurface::collider(double share) const {
  collide::Collider made;
  made.shape = collide::Shape::MESH;
  made.mesh = surface_->mesh(begin_, ways_.data(), bounds_.data());
  made.mesh.share = share;
  made.restitution = numbers_[0], made.friction = numbers_[1];
  made.margin = numbers_[2], made.depenetration = numbers_[3];
  return made;
}

MeshWay MovingSurface::way_until(double share) const {
  return {before_.drift + whole_.drift * share, before_.spread + whole_.spread * share};
}

Vec MovingSurface::way(const Mesh& mesh, std::int32_t triangle, Vec p) const {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const collide::Shares at = collide::shares_of_triangle(
      p, mesh.point(corner[0]), mesh.point(corner[1]), mesh.point(corner[2]));
  const Vec a = load(&ways_[3 * corner[0]]), b = load(&ways_[3 * corner[1]]),
            c = load(&ways_[3 * corner[2]]);
  return a + (b - a) * at.b + (c - a) * at.c;
}

}  // namespace animtool
