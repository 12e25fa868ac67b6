// Broad phase: a bounding volume tree, rebuilt in each step along a space-filling curve (Karras
// 2012, "Maximizing parallelism in the construction of BVHs"; only its order), so that time grows
// as n log n; and the contacts of pairs, at their time of impact if they are fast.
#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "rigid/world.h"

namespace animtool::rigid {

namespace {

using collide::Collider;
using collide::load;
using collide::Shape;

// Distance below which points of two bodies are in contact, over the smaller size.
constexpr double CONTACT_MARGIN_RATIO = 0.02;
// Largest number of advancements to a time of impact, and its tolerance over the smaller size.
constexpr int MAX_ADVANCES = 48;
constexpr double ARRIVAL_TOLERANCE = 1e-3;

struct Box {
  Vec low, high;
};

Box unite(const Box& a, const Box& b) {
  return {
      {std::min(a.low.x, b.low.x), std::min(a.low.y, b.low.y), std::min(a.low.z, b.low.z)},
      {std::max(a.high.x, b.high.x), std::max(a.high.y, b.high.y), std::max(a.high.z, b.high.z)}};
}

bool boxes_overlap(const Box& a, const Box& b) {
  return a.low.x <= b.high.x && b.low.x <= a.high.x && a.low.y <= b.high.y && b.low.y <= a.high.y &&
         a.low.z <= b.high.z && b.low.z <= a.high.z;
}

// The box of a core over a displacement.
Box swept_box(const PosedCore& p, Vec displacement, double slack) {
  Box box{p.points[0], p.points[0]};
  for (std::size_t i = 1; i < p.core->points.size(); ++i)
    box = unite(box, {p.points[i], p.points[i]});
  const double r = p.core->radius + slack;
  box.low = box.low - Vec{r, r, r}, box.high = box.high + Vec{r, r, r};
  return unite(box, {box.low + displacement, box.high + displacement});
}

// Inserts two zero bits after each of the lower ten bits.
std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | v << 16) & 0x030000FFu;
  v = (v | v << 8) & 0x0300F00Fu;
  v = (v | v << 4) & 0x030C30C3u;
  return (v | v << 2) & 0x09249249u;
}

// A tree of boxes in the order of the curve, halved recursively.
class BoxTree {
 public:
  explicit BoxTree(const std::vector<Box>& boxes) : boxes_(boxes), order_(boxes.size()) {
    if (boxes.empty()) return;
    Box bounds = {midpoint(0), midpoint(0)};
    for (std::size_t i = 1; i < boxes.size(); ++i)
      bounds = unite(bounds, {midpoint(i), midpoint(i)});
    const Vec size = bounds.high - bounds.low;
    std::vector<std::uint64_t> keys(boxes.size());
    const auto quantize = [](double offset, double extent) {
      const double fraction = extent > 0 ? offset / extent * 1023 : 0;
      return static_cast<std::uint32_t>(fraction > 0 ? std::min(fraction, 1023.0) : 0);
    };
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      const Vec offset = midpoint(i) - bounds.low;
      const std::uint64_t morton_code = spread_bits(quantize(offset.x, size.x)) |
                                        spread_bits(quantize(offset.y, size.y)) << 1 |
                                        spread_bits(quantize(offset.z, size.z)) << 2;
      keys[i] = morton_code << 32 | i;
    }
    std::sort(keys.begin(), keys.end());
    for (std::size_t i = 0; i < keys.size(); ++i) order_[i] = keys[i] & 0xFFFFFFFFu;
    nodes_.reserve(2 * boxes.size());
    build(0, boxes.size());
  }

  // Calls `visitor` once for each pair of overlapping boxes.
  template <class Visitor>
  void visit_pairs(Visitor visitor) const {
    for (std::size_t i = 0; i < order_.size(); ++i) visit_after(0, 0, order_.size(), i, visitor);
  }

 private:
  Vec midpoint(std::size_t i) const { return (boxes_[i].low + boxes_[i].high) * 0.5; }

  std::size_t build(std::size_t from, std::size_t to) {
    const std::size_t node = nodes_.size();
    nodes_.push_back({boxes_[order_[from]], 0});
    if (to - from > 1) {
      const std::size_t middle = from + (to - from) / 2;
      build(from, middle);
      const std::size_t right = build(middle, to);
      nodes_[node] = {unite(nodes_[node + 1].box, nodes_[right].box), right};
    }
    return node;
  }

  // Visits the leaves after leaf i in the order that overlap it.
  template <class Visitor>
  void visit_after(std::size_t node, std::size_t from, std::size_t to, std::size_t i,
                   Visitor& visitor) const {
    if (to <= i + 1 || !boxes_overlap(nodes_[node].box, boxes_[order_[i]])) return;
    if (to - from == 1) return visitor(order_[i], order_[from]);
    const std::size_t middle = from + (to - from) / 2;
    visit_after(node + 1, from, middle, i, visitor);
    visit_after(nodes_[node].right, middle, to, i, visitor);
  }

  struct Node {
    Box box;
    std::size_t right;
  };
  const std::vector<Box>& boxes_;
  std::vector<std::size_t> order_;
  std::vector<Node> nodes_;
};

// Whether a collider is a convex shape with bodies outside.
bool is_convex(const Collider& c) {
  return !c.is_container &&
         (c.shape == Shape::SPHERE || c.shape == Shape::CAPSULE || c.shape == Shape::BOX);
}

// A box about the origin with these half extents.
Core box_core(Vec half_extents) {
  Core core;
  for (int i = 0; i < 8; ++i)
    core.points.push_back({i & 1 ? half_extents.x : -half_extents.x,
                           i & 2 ? half_extents.y : -half_extents.y,
                           i & 4 ? half_extents.z : -half_extents.z});
  core.face_corners = {1, 3, 7, 5, 0, 4, 6, 2, 2, 6, 7, 3, 0, 1, 5, 4, 4, 5, 7, 6, 0, 2, 3, 1};
  core.face_starts = {0, 4, 8, 12, 16, 20, 24};
  core.build_faces();
  return core;
}

// The core of a convex collider.
Core build_core(const Collider& c) {
  if (c.shape == Shape::BOX) {
    Core core = box_core(load(c.size));
    core.radius = c.margin;
    core.build_faces();
    return core;
  }
  Core core;
  core.points.push_back(collide::load(c.size));
  if (c.shape == Shape::CAPSULE) core.points.push_back(collide::load(c.size + 3));
  core.radius = c.size[c.shape == Shape::CAPSULE ? 6 : 3] + c.margin;
  core.build_faces();
  return core;
}

// Motion of a body within a step without contacts.
struct FreeMotion {
  State begin;
  Vec velocity, angular_velocity;

  Pose pose_at(double t) const {
    State s = begin;
    s.position = s.position + velocity * t;
    s.rotation = unit(quaternion_from_vector(angular_velocity * t) * s.rotation);
    return pose_of(s);
  }
};

// Finds the contacts of a step.
class ContactFinder {
 public:
  ContactFinder(const World& world, const std::vector<State>& states,
                const std::vector<Collider>& colliders, const Settings& settings, double step)
      : world_(world), colliders_(colliders), settings_(settings), step_(step) {
    motions_.reserve(states.size());
    for (std::size_t i = 0; i < states.size(); ++i)
      motions_.push_back(
          {states[i], states[i].velocity, angular_velocity_of(world.bodies[i], states[i])});
  }

  std::vector<Contact> find_contacts() {
    pose_shapes();
    const BoxTree tree(boxes_);
    std::vector<std::pair<std::size_t, std::size_t>> pairs;
    tree.visit_pairs([&](std::size_t i, std::size_t j) {
      if (i > j) std::swap(i, j);
      if (may_collide(i, j)) pairs.emplace_back(i, j);
    });
    std::sort(pairs.begin(), pairs.end());
    for (const auto& [i, j] : pairs) collide_pair(i, j);
    for (std::size_t s = 0; s < world_.shapes.size(); ++s) {
      for (std::size_t c = 0; c < colliders_.size(); ++c) {
        if (is_convex(colliders_[c]) || (is_asleep(s) && !colliders_[c].motion.is_moving()))
          continue;
        if (is_collider_excluded(s, c)) continue;
        if (colliders_[c].shape == Shape::MESH) {
          collide_mesh(s, c);
        } else {
          collide_plane_or_container(s, c);
        }
      }
    }
    std::stable_sort(contacts_.begin(), contacts_.end(), [](const Contact& a, const Contact& b) {
      return a.first_shape != b.first_shape ? a.first_shape < b.first_shape
                                            : a.second_shape < b.second_shape;
    });
    return std::move(contacts_);
  }

 private:
  bool is_asleep(std::size_t s) const {
    return is_state_asleep(motions_[world_.shapes[s].body].begin, settings_);
  }

  std::size_t shape_count() const { return world_.shapes.size(); }

  void pose_shapes() {
    const std::size_t count = shape_count();
    body_poses_.resize(motions_.size());
    for (std::size_t i = 0; i < motions_.size(); ++i) body_poses_[i] = pose_of(motions_[i].begin);
    std::size_t points = 0;
    for (const auto& shape : world_.shapes)
      points += shape.core.points.size() + shape.core.face_count();
    posed_cores_.resize(count);
    for (std::size_t s = 0; s < count; ++s) {
      const auto& shape = world_.shapes[s];
      posed_cores_[s].set_pose(shape.core, body_poses_[shape.body]);
      const FreeMotion& motion = motions_[shape.body];
      const double sweep_radius =
          length(motion.angular_velocity) * step_ * world_.bodies[shape.body].bounding_radius;
      boxes_.push_back(swept_box(posed_cores_[s].get(), motion.velocity * step_,
                                 sweep_radius + CONTACT_MARGIN_RATIO * shape.core.bounding_radius));
      box_owners_.push_back(s);
    }
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      if (!is_convex(colliders_[c])) continue;
      const collide::Motion& motion = colliders_[c].motion;
      collider_cores_.push_back(std::make_unique<Core>(build_core(colliders_[c])));
      posed_cores_.emplace_back();
      posed_cores_.back().set_pose(*collider_cores_.back(), motion.pose_at(0));
      const double sweep_radius = motion.angle() * collider_cores_.back()->bounding_radius;
      boxes_.push_back(swept_box(posed_cores_.back().get(), motion.translation(), sweep_radius));
      box_owners_.push_back(count + c);
    }
  }

  // Whether contacts of two bodies, or of a body and a collider, are excluded; colliders are
  // numbered after the bodies.
  bool is_excluded(std::size_t a, std::size_t b) const {
    if (world_.excluded_pairs.empty()) return false;
    const std::uint64_t key = static_cast<std::uint64_t>(std::min(a, b)) << 32 | std::max(a, b);
    return std::binary_search(world_.excluded_pairs.begin(), world_.excluded_pairs.end(), key);
  }

  bool is_collider_excluded(std::size_t s, std::size_t c) const {
    return is_excluded(world_.shapes[s].body, world_.bodies.size() + c);
  }

  // Whether two boxes may collide; i is below j, and shapes come before colliders.
  bool may_collide(std::size_t i, std::size_t j) const {
    if (i >= shape_count()) return false;
    if (j >= shape_count()) {
      const Collider& c = colliders_[box_owners_[j] - shape_count()];
      return (!is_asleep(i) || c.motion.is_moving()) &&
             !is_collider_excluded(i, box_owners_[j] - shape_count());
    }
    const std::size_t a = world_.shapes[i].body, b = world_.shapes[j].body;
    return a != b && !(is_asleep(i) && is_asleep(j)) && !is_excluded(a, b);
  }

  // Upper bound of the approach of two bodies along a direction.
  static double approach_bound(Vec displacement, double rotation_bound, Vec normal) {
    return std::max(-dot(displacement, normal), 0.0) + rotation_bound;
  }

  // Adds the contact of two posed cores.
  void collide_pair(std::size_t i, std::size_t j) {
    const PosedCore& p = posed_cores_[i].get();
    const PosedCore& q = posed_cores_[j].get();
    const std::size_t a = world_.shapes[i].body;
    const bool is_collider = j >= shape_count();
    const std::size_t b = is_collider ? 0 : world_.shapes[j].body;
    const double min_bounding_radius = std::min(p.core->bounding_radius, q.core->bounding_radius),
                 contact_margin = CONTACT_MARGIN_RATIO * min_bounding_radius;
    const collide::Motion* motion =
        is_collider ? &colliders_[box_owners_[j] - shape_count()].motion : nullptr;
    const Vec other_velocity =
        is_collider ? motion->translation() * (1 / step_) : motions_[b].velocity;
    const Vec displacement = (other_velocity - motions_[a].velocity) * step_;
    const double other_rotation =
        is_collider ? motion->angle() : length(motions_[b].angular_velocity) * step_;
    const double rotation_bound =
        length(motions_[a].angular_velocity) * step_ * p.core->bounding_radius +
        other_rotation * q.core->bounding_radius;
    const double max_displacement = length(displacement) + rotation_bound;
    const Axis axis =
        separating_axis(p, q, max_displacement + contact_margin + p.core->radius + q.core->radius);
    const double gap = axis.gap - p.core->radius - q.core->radius;
    if (gap > max_displacement + contact_margin) return;
    Contact contact;
    contact.motion = motion;
    contact.radius = p.core->radius, contact.other_radius = q.core->radius;
    // Near or slow pairs are tested at the start; distant and fast ones at their arrival.
    if (gap <=
        contact_margin + std::min(max_displacement, min_bounding_radius * ARRIVAL_TOLERANCE)) {
      const Manifold manifold = find_manifold(p, q, contact_margin + max_displacement);
      contact.set_manifold(manifold, body_poses_[a],
                           is_collider ? motion->pose_at(0) : body_poses_[b]);
    } else {
      advance_to_impact(p, q, a, b, motion, contact, gap, axis, displacement, rotation_bound,
                        min_bounding_radius, max_displacement);
    }
    if (!contact.count) return;
    contact.first_shape = i, contact.second_shape = static_cast<std::int64_t>(box_owners_[j]);
    contact.body_a = a, contact.body_b = is_collider ? -1 : static_cast<std::ptrdiff_t>(b);
    Material other_material;
    if (is_collider) {
      const Collider& c = colliders_[box_owners_[j] - shape_count()];
      other_material = {c.restitution, c.friction}, contact.depenetration = c.depenetration;
    } else {
      other_material = world_.shapes[j].material;
    }
    contact.material = combine_materials(world_.shapes[i].material, other_material);
    contacts_.push_back(contact);
  }

  static Material combine_materials(const Material& a, const Material& b) {
    return {std::max(a.restitution, b.restitution), std::max(a.friction, b.friction)};
  }

  // Finds the contact at the time of impact by conservative advancement (Mirtich 1996,
  // "Impulse-based dynamic simulation").
  void advance_to_impact(const PosedCore& p, const PosedCore& q, std::size_t a, std::size_t b,
                         const collide::Motion* motion, Contact& contact, double gap, Axis axis,
                         Vec displacement, double rotation_bound, double min_bounding_radius,
                         double max_displacement) {
    const double tolerance = ARRIVAL_TOLERANCE * min_bounding_radius,
                 radius_sum = p.core->radius + q.core->radius;
    Pose pose_a, pose_b;
    double fraction = 0;
    for (int i = 0; i < MAX_ADVANCES; ++i) {
      const double speed = approach_bound(displacement, rotation_bound, axis.normal);
      if (!(speed > 0)) return;
      fraction += std::max(gap - tolerance / 2, tolerance / 2) / speed;
      if (fraction > 1) return;
      pose_a = motions_[a].pose_at(fraction * step_);
      pose_b = motion ? motion->pose_at(fraction) : motions_[b].pose_at(fraction * step_);
      advanced_core_a_.set_pose(*p.core, pose_a);
      advanced_core_b_.set_pose(*q.core, pose_b);
      axis = separating_axis(advanced_core_a_.get(), advanced_core_b_.get(), collide::INF);
      gap = axis.gap - radius_sum;
      if (gap <= tolerance) break;
    }
    const double max_gap = std::max(gap, 0.0) + CONTACT_MARGIN_RATIO * min_bounding_radius +
                           max_displacement * (1 - fraction);
    contact.set_manifold(find_manifold(advanced_core_a_.get(), advanced_core_b_.get(), max_gap),
                         pose_a, pose_b);
  }

  // Adds a contact of a shape with a collider.
  void add_contact(std::size_t s, std::size_t c, const Manifold& manifold) {
    Contact contact;
    const Collider& collider = colliders_[c];
    contact.first_shape = s, contact.second_shape = static_cast<std::int64_t>(shape_count() + c);
    contact.body_a = world_.shapes[s].body, contact.body_b = -1;
    contact.radius = world_.shapes[s].core.radius;
    contact.set_manifold(manifold, body_poses_[contact.body_a], collider.motion.pose_at(0));
    contact.motion = &collider.motion;
    contact.depenetration = collider.depenetration;
    contact.material =
        combine_materials(world_.shapes[s].material, {collider.restitution, collider.friction});
    contacts_.push_back(contact);
  }

  // Samples one of the six walls of a container, from inside.
  static collide::Sample sample_wall(const Collider& c, const Pose& pose, Vec point, double radius,
                                     int wall) {
    const Vec local = pose.to_local(point);
    const double coordinates[3] = {local.x, local.y, local.z}, sign = wall % 2 ? -1 : 1;
    double inward[3] = {0, 0, 0};
    inward[wall / 2] = -sign;
    return {c.size[wall / 2] - sign * coordinates[wall / 2] - c.margin - radius,
            pose.rotate(load(inward))};
  }

  // Collides a shape with a plane or container: contact points, grouped by their normals.
  void collide_plane_or_container(std::size_t s, std::size_t c) {
    const PosedCore& p = posed_cores_[s].get();
    const Collider& collider = colliders_[c];
    const FreeMotion& motion = motions_[world_.shapes[s].body];
    const double max_gap = CONTACT_MARGIN_RATIO * p.core->bounding_radius +
                           length(motion.angular_velocity) * step_ * p.core->bounding_radius +
                           length(motion.velocity * step_ - collider.motion.translation()) +
                           collider.motion.angle() * length(p.centre);
    const Pose pose = collider.motion.pose_at(0);
    const double bounding_distance =
        length(p.centre - body_poses_[world_.shapes[s].body].origin) + p.core->bounding_radius;
    if (collide::sample(collider, pose, p.centre, bounding_distance, max_gap).distance > max_gap)
      return;
    points_by_normal_.clear();
    const int wall_count = collider.shape == Shape::BOX ? 6 : 1;
    for (std::size_t i = 0; i < wall_count * p.core->points.size(); ++i) {
      const Vec point = p.points[i / static_cast<std::size_t>(wall_count)];
      const auto sample = wall_count == 1
                              ? collide::sample(collider, pose, point, p.core->radius, max_gap)
                              : sample_wall(collider, pose, point, p.core->radius,
                                            static_cast<int>(i) % wall_count);
      if (sample.distance > max_gap) continue;
      const Vec n = -sample.normal;
      const ContactPoint contact_point{point + n * (p.core->radius + sample.distance / 2),
                                       sample.distance};
      auto group =
          std::find_if(points_by_normal_.begin(), points_by_normal_.end(),
                       [&](const auto& candidate) { return dot(candidate.first, n) > 1 - 1e-9; });
      if (group == points_by_normal_.end())
        group = points_by_normal_.insert(points_by_normal_.end(), {n, {}});
      group->second.push_back(contact_point);
    }
    for (auto& [n, points] : points_by_normal_) {
      Manifold manifold;
      manifold.normal = n;
      reduce_to_four(points, n, manifold);
      add_contact(s, c, manifold);
    }
  }

  // Collides a shape with the triangles of a mesh.
  void collide_mesh(std::size_t s, std::size_t c) {
    const PosedCore& p = posed_cores_[s].get();
    const Collider& collider = colliders_[c];
    const Pose pose = collider.motion.pose_at(0);
    const collide::Mesh& mesh = collider.mesh;
    const FreeMotion& motion = motions_[world_.shapes[s].body];
    const Vec displacement = motion.velocity * step_ - collider.motion.translation();
    const double rotation_bound =
        length(motion.angular_velocity) * step_ * p.core->bounding_radius +
        collider.motion.angle() * length(p.centre - pose.origin);
    const double max_gap = CONTACT_MARGIN_RATIO * p.core->bounding_radius + length(displacement) +
                           rotation_bound + collider.margin;
    Box local_box{pose.to_local(p.points[0]), pose.to_local(p.points[0])};
    for (std::size_t i = 1; i < p.core->points.size(); ++i) {
      const Vec point = pose.to_local(p.points[i]);
      local_box = unite(local_box, {point, point});
    }
    const double r = p.core->radius + max_gap;
    const std::size_t previous_count = contacts_.size();
    bool is_behind_some_triangle = false;
    collide::visit_overlapping(mesh, collider.mesh_root, local_box.low - Vec{r, r, r},
                               local_box.high + Vec{r, r, r}, [&](std::int32_t t) {
                                 is_behind_some_triangle |=
                                     !collide_triangle(s, c, t, pose, max_gap);
                               });
    if (is_behind_some_triangle && contacts_.size() == previous_count)
      collide_inside(s, c, pose, max_gap);
  }

  // Adds the contact of a body whose centre is inside of a mesh, along the outward direction of the
  // nearest point.
  void collide_inside(std::size_t s, std::size_t c, const Pose& pose, double max_gap) {
    const PosedCore& p = posed_cores_[s].get();
    const auto surface =
        collide::sample(colliders_[c], pose, p.centre, 0, p.core->bounding_radius + max_gap);
    if (!(surface.distance < 0)) return;
    std::vector<ContactPoint> points;
    for (std::size_t i = 0; i < p.core->points.size(); ++i) {
      const Vec point = p.points[i];
      const double gap = surface.distance + dot(surface.normal, point - p.centre) - p.core->radius;
      if (gap <= max_gap)
        points.push_back({point - surface.normal * (p.core->radius + gap / 2), gap});
    }
    Manifold manifold;
    manifold.normal = -surface.normal;
    reduce_to_four(points, manifold.normal, manifold);
    add_contact(s, c, manifold);
  }

  // Whether a point in the world is behind a triangle of a mesh.
  static bool is_behind(const collide::Mesh& mesh, std::int32_t t, const Pose& pose, Vec point) {
    const std::int32_t* corner = mesh.triangles + 3 * t;
    const Vec a = mesh.point(corner[0]), local = pose.to_local(point);
    return dot(cross(mesh.point(corner[1]) - a, mesh.point(corner[2]) - a), local - a) < 0;
  }

  // Collides a shape with a triangle; returns whether the shape is in front of it.
  bool collide_triangle(std::size_t s, std::size_t c, std::int32_t t, const Pose& pose,
                        double max_gap) {
    const PosedCore& p = posed_cores_[s].get();
    const collide::Mesh& mesh = colliders_[c].mesh;
    Core core;
    // Containers collide from behind, two-sided triangles from the side of the body.
    const bool is_two_sided = colliders_[c].is_two_sided;
    const bool is_flipped =
        colliders_[c].is_container || (is_two_sided && is_behind(mesh, t, pose, p.centre));
    for (int k = 0; k < 3; ++k)
      core.points.push_back(mesh.point(mesh.triangles[3 * t + (is_flipped ? (3 - k) % 3 : k)]));
    core.face_corners = {0, 1, 2, 0, 2, 1};
    core.face_starts = {0, 3, 6};
    core.radius = colliders_[c].margin;
    core.build_faces();
    advanced_core_b_.set_pose(core, pose);
    const PosedCore& q = advanced_core_b_.get();
    const Vec face_normal = q.normals[0];
    // Bodies behind a face collide with its other side, or with the complete mesh.
    if (!is_two_sided && dot(p.centre - q.points[0], face_normal) < 0) return false;
    Manifold manifold = find_manifold(q, p, max_gap);
    if (!manifold.count) return true;
    if (!is_in_normal_cone(mesh, t, is_flipped, pose, manifold, q))
      manifold = triangle_manifold(q, p, max_gap, is_two_sided);
    if (!manifold.count) return true;
    manifold.normal = -manifold.normal;
    add_contact(s, c, manifold);
    return true;
  }

  // Whether a normal is in the normal cone of the surface: at an edge, between the normals of its
  // two faces, so that sliding bodies do not catch on inner edges.
  static bool is_in_normal_cone(const collide::Mesh& mesh, std::int32_t t, bool is_flipped,
                                const Pose& pose, const Manifold& manifold, const PosedCore& q) {
    const Vec n = manifold.normal, face_normal = q.normals[0];
    const double cosine = dot(n, face_normal);
    if (cosine > 1 - 1e-6) return true;
    if (cosine <= 0) return false;
    const Vec point = manifold.points[0].position;
    int side = 0;
    double min_squared = collide::INF;
    for (int k = 0; k < 3; ++k) {
      const Vec a = q.points[k], b = q.points[(k + 1) % 3], edge = b - a;
      const double fraction = std::clamp(dot(point - a, edge) / dot(edge, edge), 0.0, 1.0);
      const Vec offset = point - a - edge * fraction;
      if (dot(offset, offset) < min_squared) min_squared = dot(offset, offset), side = k;
    }
    const Vec edge_normal =
        pose.rotate(load(mesh.edge_normals + 9 * t + 3 * (is_flipped ? 2 - side : side)));
    const Vec normal_sum = is_flipped ? -edge_normal : edge_normal;
    if (dot(normal_sum, normal_sum) == 0) return true;  // a boundary edge
    const Vec other_normal =
        direction(direction(normal_sum, face_normal) *
                          (2 * dot(direction(normal_sum, face_normal), face_normal)) -
                      face_normal,
                  face_normal);
    const Vec edge = q.points[(side + 1) % 3] - q.points[side];
    const Vec outward = cross(edge, face_normal);
    if (dot(other_normal, outward) <= 1e-6) return false;  // flat, or concave
    return cosine >= dot(other_normal, face_normal) - 1e-3;
  }

  // Whether a segment crosses a triangle.
  static bool is_crossing(const PosedCore& q, Vec from, Vec to) {
    const Vec n = q.normals[0], displacement = to - from;
    const double start_height = dot(n, from - q.points[0]), end_height = dot(n, to - q.points[0]);
    if ((start_height > 0) == (end_height > 0)) return false;
    const Vec point = from + displacement * (start_height / (start_height - end_height));
    for (int k = 0; k < 3; ++k)
      if (dot(cross(q.points[(k + 1) % 3] - q.points[k], point - q.points[k]), n) < 0) return false;
    return true;
  }

  // Contact points of a core on the front of a triangle.
  static Manifold triangle_manifold(const PosedCore& q, const PosedCore& p, double max_gap,
                                    bool is_two_sided) {
    const Vec n = q.normals[0];
    std::vector<ContactPoint> points;
    for (std::size_t i = 0; i < p.core->points.size(); ++i) {
      const Vec point = p.points[i];
      const double height = dot(n, point - q.points[0]);
      const double gap = height - p.core->radius - q.core->radius;
      if (gap > max_gap) continue;
      bool is_inside = true;
      for (int k = 0; k < 3; ++k)
        is_inside &= dot(cross(q.points[(k + 1) % 3] - q.points[k], point - q.points[k]), n) >= 0;
      // Behind a two-sided triangle, only points that crossed the triangle count. Points that
      // passed outside its edges do not.
      if (is_inside && is_two_sided && height < 0) is_inside = is_crossing(q, p.centre, point);
      if (is_inside) points.push_back({point - n * (height - q.core->radius - gap / 2), gap});
    }
    Manifold manifold;
    manifold.normal = n;
    reduce_to_four(points, n, manifold);
    return manifold;
  }

  const World& world_;
  const std::vector<Collider>& colliders_;
  const Settings& settings_;
  double step_;
  std::vector<FreeMotion> motions_;
  std::vector<Pose> body_poses_;
  std::vector<CorePoser> posed_cores_;
  std::vector<Box> boxes_;
  std::vector<std::size_t>
      box_owners_;  // of each box: a shape, or a collider, numbered after the shapes
  std::vector<std::unique_ptr<Core>> collider_cores_;
  std::vector<std::pair<Vec, std::vector<ContactPoint>>> points_by_normal_;
  CorePoser advanced_core_a_, advanced_core_b_;
  std::vector<Contact> contacts_;
};

}  // namespace

std::vector<Contact> find_contacts(const World& world, const std::vector<State>& states,
                                   const std::vector<Collider>& colliders, const Settings& settings,
                                   double step) {
  return ContactFinder(world, states, colliders, settings, step).find_contacts();
}

}  // namespace animtool::rigid
