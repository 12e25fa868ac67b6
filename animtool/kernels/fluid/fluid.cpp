// Steps of a fluid, and its density.
#include "fluid/fluid.h"

#include <algorithm>
#include <array>

#include "base/checks.h"
#include "fluid/film.h"
#include "fluid/lanes.h"
#include "fluid/steps.h"
#include "particles/neighbours.h"
#include "springs/contacts.h"

namespace animtool {

namespace fluid {

using collide::Collider;
using collide::load;
using collide::Pose;
using collide::Sample;
using collide::Shape;
using collide::store;

namespace {

struct alignas(32) Row {
  double x = 0, y = 0, z = 0, w = 0;

  Vec vec() const { return {x, y, z}; }
};

// A body that the fluid pushes, with its displacement from free motion.
struct Body {
  double inverse_mass = 0;                  // 1 over its mass
  double inverse_inertia[6];                // its inverse inertia: xx, yy, zz, xy, xz, yz
  Vec begin, end;                           // its centre of mass
  Vec shift, rotation;                      // displacement from that, so far
  Vec velocity, spin;                       // likewise
  double impulse[6] = {}, delayed[6] = {};  // impulses and angular impulses about the origin

  Vec angular_change(Vec moment) const {
    return {inverse_inertia[0] * moment.x + inverse_inertia[3] * moment.y +
                inverse_inertia[4] * moment.z,
            inverse_inertia[3] * moment.x + inverse_inertia[1] * moment.y +
                inverse_inertia[5] * moment.z,
            inverse_inertia[4] * moment.x + inverse_inertia[5] * moment.y +
                inverse_inertia[2] * moment.z};
  }
};

Pose shifted(const Pose& pose, const Body& body, Vec centre) {
  Pose shifted_pose = pose;
  const double angle = length(body.rotation);
  if (angle > 0) {
    const double vector[3] = {body.rotation.x, body.rotation.y, body.rotation.z};
    double quaternion[4];
    Pose change;
    ik::exponential(vector, quaternion);
    ik::normalize(quaternion);
    ik::to_matrix(quaternion, change.rotation);
    shifted_pose.origin = centre + change.rotated(pose.origin - centre);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        shifted_pose.rotation[3 * i + j] = 0;
        for (int k = 0; k < 3; ++k)
          shifted_pose.rotation[3 * i + j] += change.rotation[3 * i + k] * pose.rotation[3 * k + j];
      }
  }
  shifted_pose.origin = shifted_pose.origin + body.shift;
  return shifted_pose;
}

struct FluidRule {
  double spacing, density, viscosity, tension;
  double radius() const { return REACH * spacing; }
  double mass() const { return density * spacing * spacing * spacing; }
};

class Steps {
 public:
  Steps(const FluidRule& rule, std::vector<Collider> colliders, std::vector<std::int32_t> owners,
        std::vector<Body> bodies, double step, double sound)
      : rule_(rule),
        sound_(sound),
        colliders_(std::move(colliders)),
        owners_(std::move(owners)),
        bodies_(std::move(bodies)),
        step_(step),
        radius_(rule.radius()),
        lattice_(Walls::lattice()) {}

  void begin(const double* state, const double* accelerations, std::size_t count) {
    count_ = count;
    const std::size_t rows = count + 1;
    order_.assign(rows, static_cast<std::int32_t>(count));
    point_.assign(rows, {PADDING_POSITION, PADDING_POSITION, PADDING_POSITION, 0});
    before_ = point_;
    velocity_.assign(rows, {}), accelerations_.assign(rows, {}), pressure_.assign(rows, 0);
    for (std::size_t i = 0; i < count; ++i) {
      order_[i] = static_cast<std::int32_t>(i);
      const double *x = state + 3 * i, *v = state + 3 * (count + i), *a = accelerations + 3 * i;
      point_[i] = {x[0], x[1], x[2], 0};
      velocity_[i] = {v[0], v[1], v[2], 0};
      accelerations_[i] = {a[0], a[1], a[2], 0};
    }
    poses_.resize(colliders_.size());
    old_poses_.resize(colliders_.size());
    pose_colliders(0, poses_);
  }

  // Takes the substeps one after the other.
  void run(std::size_t substeps) {
    const double h = step_ / static_cast<double>(substeps);
    // Short substeps are as stiff as long ones, up to the stability limit.
    const double fraction = std::min(sound_ * h / rule_.spacing, 1.0);
    relaxation_ = RELAXATION * fraction * fraction;
    for (std::size_t k = 0; k < substeps; ++k) {
      const double fraction = static_cast<double>(k + 1) / static_cast<double>(substeps);
      predict(h);
      old_poses_ = poses_;
      pose_colliders(fraction, poses_);
      if (!listed_ || stale()) list();
      measure_density();
      apply_tension(h, k, substeps);
      apply_pressure(h);
      resolve_contacts(h);
      apply_damping(h, k, substeps);
      push_bodies(h, 1 - fraction);
    }
    for (double& one : pressure_) one /= static_cast<double>(substeps);
  }

  void store_state(double* state, double* pressure) const {
    for (std::size_t i = 0; i < count_; ++i) {
      const std::size_t to = static_cast<std::size_t>(order_[i]);
      store(point_[i].vec(), state + 3 * to);
      store(velocity_[i].vec(), state + 3 * (count_ + to));
      pressure[to] = pressure_[i];
    }
  }

  // Densities over that at rest, without motion.
  void densities(double* out) {
    before_ = point_;
    list();
    measure_density();
    for (std::size_t i = 0; i < count_; ++i) out[order_[i]] = 1 + excess_densities_[i];
  }

  const std::vector<Body>& bodies() const { return bodies_; }
  double compression() const { return compression_; }

 private:
  struct ColliderContact {
    std::int32_t collider;
    WallContribution contribution;
    Vec correction = {};  // displacement, then the velocity change from it
    Vec point = {};
  };

  void predict(double h) {
    for (std::size_t i = 0; i < count_; ++i) {
      Row& x = point_[i];
      Row& v = velocity_[i];
      const Row& a = accelerations_[i];
      before_[i] = x;
      v.x += h * a.x, v.y += h * a.y, v.z += h * a.z;
      x.x += h * v.x, x.y += h * v.y, x.z += h * v.z;
    }
  }

  void pose_colliders(double fraction, std::vector<Pose>& poses) const {
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      poses[c] = colliders_[c].motion.at(fraction);
      if (owners_[c] < 0) continue;
      const Body& body = bodies_[static_cast<std::size_t>(owners_[c])];
      poses[c] = shifted(poses[c], body, body.begin + (body.end - body.begin) * fraction);
    }
  }

  // Whether particles or colliders may be near each other that no list contains.
  bool stale() const {
    double squared = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      const double x = point_[i].x - listed_at_[i].x, y = point_[i].y - listed_at_[i].y,
                   z = point_[i].z - listed_at_[i].z;
      squared = std::max(squared, x * x + y * y + z * z);
    }
    const double room = SKIN * radius_, moved = std::sqrt(squared);
    if (!(2 * moved <= room)) return true;
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      const Pose &was = listed_poses_[c], &is = poses_[c];
      double turned = 0;
      for (int k = 0; k < 9; ++k) turned += std::fabs(is.rotation[k] - was.rotation[k]);
      const double far = length(is.origin - middle_) + extent_;
      if (!(moved + length(is.origin - was.origin) + turned * far <= room)) return true;
    }
    return false;
  }

  template <class T>
  void reorder(std::vector<T>& values, const std::vector<std::int32_t>& by) {
    std::vector<T> reordered(values.size());
    for (std::size_t i = 0; i < by.size(); ++i)
      reordered[i] = values[static_cast<std::size_t>(by[i])];
    values.swap(reordered);
  }

  // Sorts particles by grid cells, and lists neighbours until the list is stale.
  void list() {
    std::vector<double> points(3 * count_);
    for (std::size_t i = 0; i < count_; ++i) store(point_[i].vec(), &points[3 * i]);
    const double none[3] = {0, 0, 0};
    const Neighbours grid(points.data(), nullptr, count_, radius_ * (1 + SKIN), none, none);
    std::vector<std::int32_t> by(grid.index(), grid.index() + grid.size());
    // Non-finite particles have no neighbours, and come last.
    if (by.size() < count_) {
      std::vector<bool> there(count_);
      for (const std::int32_t i : by) there[static_cast<std::size_t>(i)] = true;
      for (std::size_t i = 0; i < count_; ++i)
        if (!there[i]) by.push_back(static_cast<std::int32_t>(i));
    }
    by.push_back(static_cast<std::int32_t>(count_));
    reorder(order_, by), reorder(point_, by), reorder(before_, by), reorder(velocity_, by);
    reorder(accelerations_, by), reorder(pressure_, by);
    neighbour_starts_.assign(count_ + 1, 0);
    partners_.clear();
    grid.visit_all<true>(
        std::numeric_limits<double>::infinity(),
        [&](std::size_t i, const double*, const std::int32_t* hit, const std::int32_t* end) {
          partners_.insert(partners_.end(), hit, end);
          while (partners_.size() % WIDE) partners_.push_back(by.back());
          neighbour_starts_[i + 1] = partners_.size();
        });
    for (std::size_t i = grid.size(); i < count_; ++i) neighbour_starts_[i + 1] = partners_.size();
    factor_.resize(partners_.size());
    listed_at_ = point_;
    listed_poses_ = poses_;
    listed_ = true;
    list_colliders();
    if (rule_.tension > 0) film_.list(&point_.data()->x, count_);
    excess_densities_.resize(count_), virial_.resize(count_);
  }

  void list_colliders() {
    Vec low{}, high{};
    for (std::size_t i = 0; i < count_; ++i) {
      const Row& x = point_[i];
      if (!i) low = high = x.vec();
      low = {std::min(low.x, x.x), std::min(low.y, x.y), std::min(low.z, x.z)};
      high = {std::max(high.x, x.x), std::max(high.y, x.y), std::max(high.z, x.z)};
    }
    middle_ = (low + high) * 0.5;
    extent_ = length(high - low) / 2 + radius_;
    contacts_.clear();
    contact_starts_.assign(count_ + 1, 0);
    const double reach = radius_ * (1 + SKIN);
    std::vector<std::size_t> close;
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      if (collide::sample(colliders_[c], poses_[c], middle_, 0, extent_ + reach).distance <
          extent_ + reach)
        close.push_back(c);
    for (std::size_t i = 0; i < count_; ++i) {
      for (const std::size_t c : close)
        if (collide::sample(colliders_[c], poses_[c], point_[i].vec(), 0, reach).distance < reach)
          contacts_.push_back({static_cast<std::int32_t>(c), {}});
      contact_starts_[i + 1] = contacts_.size();
    }
  }

  FluidPairs pairs() {
    const double inverse = 1 / radius_;
    // Second derivative factor of the weight, over the distance.
    const double steep = -3 * inverse * inverse / lattice_;
    return {count_,
            neighbour_starts_.data(),
            partners_.data(),
            &point_.data()->x,
            &velocity_.data()->x,
            factor_.data(),
            &sums_.data()->x,
            &corrections_.data()->x,
            squares_.data(),
            inverse,
            steep,
            0,
            0};
  }

  // The density of each, and its gradient.
  void measure_density() {
    sums_.assign(count_ + 1, {}), corrections_.assign(count_ + 1, {}),
        squares_.assign(count_ + 1, 0);
    loops_.measure_density(pairs());
    const double scale = 1 / lattice_, steep = Walls::steepness() / (radius_ * radius_);
    const double per_wall = Walls::virial();
    double sum = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      Row slope = sums_[i];
      const double inner = (1 + slope.w) * scale - 1;
      slope.w = squares_[i];
      const double beyond = measure_colliders(i, scale, slope), dense = inner + beyond;
      excess_densities_[i] = dense;
      const double excess = std::max(dense, 0.0);
      sum += excess;
      const double steepness = slope.x * slope.x + slope.y * slope.y + slope.z * slope.z + slope.w;
      point_[i].w =
          excess > 0 ? -relaxation_ * excess / std::max(GRADIENT_DAMPING * steepness, steep) : 0.0;
      // A wall presses as the lattice layers it replaces would.
      virial_[i] = -per_wall * beyond * point_[i].w;
    }
    compression_ = count_ ? sum / static_cast<double>(count_) : 0.0;
  }

  // Surface tension. One evaluation covers as many substeps as the shortest ripples allow.
  void apply_tension(double h, std::size_t substep, std::size_t substeps) {
    if (!(rule_.tension > 0)) return;
    const double period = std::sqrt(rule_.mass() / rule_.tension);
    const double max_substeps =
        std::min(CAPILLARY_LIMIT * period / h, static_cast<double>(substeps));
    const std::size_t combined = std::max<std::size_t>(static_cast<std::size_t>(max_substeps), 1);
    if (substep % combined != 0) return;
    const double duration = h * static_cast<double>(std::min(combined, substeps - substep));
    film_.measure(&point_.data()->x, count_);
    film_.pull(&point_.data()->x, count_, -rule_.tension * h * duration / rule_.mass(),
               &corrections_.data()->x);
  }

  // Velocity damping comes before the next neighbour update: together with pressure it would
  // overshoot.
  void apply_damping(double h, std::size_t substep, std::size_t substeps) {
    std::fill(corrections_.begin(), corrections_.end(), Row());
    const bool is_viscous = apply_viscosity(h, substep, substeps),
               is_damped = damp_noise(h, substep, substeps);
    if (!is_viscous && !is_damped) return;
    for (std::size_t i = 0; i < count_; ++i) {
      velocity_[i].x += corrections_[i].x, velocity_[i].y += corrections_[i].y;
      velocity_[i].z += corrections_[i].z;
    }
  }

  // Viscosity. One evaluation covers as many substeps as are stable together.
  bool apply_viscosity(double h, std::size_t substep, std::size_t substeps) {
    const double max_substeps =
        VISCOUS_LIMIT * rule_.spacing * rule_.spacing / (rule_.viscosity * h);
    const std::size_t combined =
        max_substeps < static_cast<double>(substeps)
            ? std::max<std::size_t>(static_cast<std::size_t>(max_substeps), 1)
            : substeps;
    if (!(rule_.viscosity > 0) || substep % combined != 0) return false;
    FluidPairs layout = pairs();
    layout.damping =
        -2 * rule_.viscosity * h * static_cast<double>(std::min(combined, substeps - substep));
    loops_.apply_viscosity(layout);
    return true;
  }

  // Removes the noise of particles, averaged over many substeps.
  bool damp_noise(double h, std::size_t substep, std::size_t substeps) {
    // Not what viscosity takes itself. Drops that are pulled together would set.
    if (rule_.tension > 0) return false;
    const double strength = 1 - rule_.viscosity / (NOISE_VISCOSITY * sound_ * rule_.spacing);
    if (substep % NOISE_SUBSTEPS != 0 || !(strength > 0)) return false;
    const double fraction = std::min(sound_ * h / rule_.spacing, 1.0);
    FluidPairs layout = pairs();
    layout.noise = NOISE * sound_;
    layout.damping = -NOISE_DECAY * strength * fraction *
                     static_cast<double>(std::min(NOISE_SUBSTEPS, substeps - substep));
    loops_.damp_noise(layout);
    return true;
  }

  double measure_colliders(std::size_t i, double scale, Row& slope) {
    const std::size_t first = contact_starts_[i], last = contact_starts_[i + 1];
    if (first == last) return 0;
    double open_fraction = 1;
    for (std::size_t k = first; k < last; ++k) {
      const std::size_t c = static_cast<std::size_t>(contacts_[k].collider);
      contacts_[k].contribution =
          wall_contribution(colliders_[c], poses_[c], point_[i].vec(), radius_);
      open_fraction *= 1 - contacts_[k].contribution.fraction;
    }
    const double full = walls().full() * scale;
    for (std::size_t k = first; k < last; ++k) {
      double others = full;
      for (std::size_t m = first; m < last; ++m)
        if (m != k) others *= 1 - contacts_[m].contribution.fraction;
      Vec& gradient = contacts_[k].contribution.slope;
      gradient = gradient * others;
      contacts_[k].contribution.push = contacts_[k].contribution.push * others;
      slope.x += gradient.x, slope.y += gradient.y, slope.z += gradient.z;
      slope.w += dot(gradient, gradient);
    }
    return full * (1 - open_fraction);
  }

  // Moves dense particles apart.
  void apply_pressure(double h) {
    loops_.apply_pressure(pairs());
    const double per = rule_.density / (h * h);
    for (std::size_t i = 0; i < count_; ++i) {
      pressure_[i] += (virial_[i] + corrections_[i].w) * per;
      Vec to = point_[i].vec() + corrections_[i].vec();
      for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
        // The wall presses as the fluid in front of it does.
        const Vec by = contacts_[k].contribution.push * point_[i].w;
        contacts_[k].correction = by;
        to = to + by;
      }
      point_[i].x = to.x, point_[i].y = to.y, point_[i].z = to.z;
    }
  }

  // Displacement of a point of a collider in the substep.
  Vec transported(std::size_t c, Vec point) const {
    return point - old_poses_[c].to_world(poses_[c].to_local(point));
  }

  static constexpr int WALLS = 3;
  // Between two colliders each pushes into the other: this many iterations, and no further than
  // this fraction of a spacing.
  static constexpr int ALTERNATIONS = 16;
  static constexpr double CONTACT_TOLERANCE = 1e-4;

  // Keeps particles out of colliders, and updates their velocities.
  void resolve_contacts(double h) {
    const double rate = 1 / h, size = rule_.spacing / 2;
    for (std::size_t i = 0; i < count_; ++i) {
      Vec x = point_[i].vec();
      Vec v = (x - before_[i].vec()) * rate;
      int touched = 0;
      for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
        ColliderContact& contact = contacts_[k];
        const Vec impulse = contact.correction * rate, old = v;
        touched += resolve_contact(contact, before_[i].vec(), rate, length(impulse), x, v) > 0;
        contact.correction = impulse + (v - old);
      }
      for (int round = 0; round < ALTERNATIONS && touched > 1; ++round) {
        double deepest = 0;
        for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
          const Vec old = v;
          deepest =
              std::max(deepest, resolve_contact(contacts_[k], before_[i].vec(), rate, 0, x, v));
          contacts_[k].correction = contacts_[k].correction + (v - old);
        }
        if (deepest <= CONTACT_TOLERANCE * size) break;
      }
      point_[i].x = x.x, point_[i].y = x.y, point_[i].z = x.z;
      velocity_[i] = {v.x, v.y, v.z, 0};
    }
  }

  // Moves a position and velocity out of a collider with an impulse; returns the penetration depth.
  double resolve_contact(ColliderContact& contact, Vec before, double rate, double normal_impulse,
                         Vec& x, Vec& v) {
    const double size = rule_.spacing / 2;
    const std::size_t c = static_cast<std::size_t>(contact.collider);
    const Collider& collider = colliders_[c];
    double deepest = 0;
    // The walls of a container's corner collide one after another.
    for (int wall = 0; wall < WALLS; ++wall) {
      const Vec from = poses_[c].to_local(before);
      const Sample sample = collide::sample_since(collider, from, poses_[c], x, size, size);
      if (!wall) contact.point = x - sample.normal * (sample.distance + size);
      const bool touches = sample.distance < 0;
      if (!touches && (wall || !(collider.friction > 0 && normal_impulse > 0))) break;
      deepest = std::max(deepest, -sample.distance);
      const Vec surface = transported(c, x) * rate;
      const double normal_velocity = dot(v - surface, sample.normal);
      if (touches) {
        x = x - sample.normal * sample.distance;
        if (normal_velocity < 0) {
          v = v - sample.normal * ((1 + collider.restitution) * normal_velocity);
          normal_impulse -= normal_velocity;
        }
      }
      if (collider.friction > 0 && normal_impulse > 0) {
        const Vec relative = v - surface;
        const Vec along = relative - sample.normal * dot(relative, sample.normal);
        const double speed = length(along), friction_limit = collider.friction * normal_impulse;
        v = v - along * (speed > friction_limit ? friction_limit / speed : 1.0);
        normal_impulse = 0;
      }
      if (!touches || collider.shape != Shape::BOX || !collider.container) break;
    }
    return deepest;
  }

  // Bodies take the opposite impulses of particles.
  void push_bodies(double h, double remaining_fraction) {
    if (bodies_.empty()) return;
    const double fraction = 1 - remaining_fraction;
    std::vector<Vec> impulses(bodies_.size()), twists(bodies_.size());
    const double mass = rule_.mass();
    for (const ColliderContact& contact : contacts_) {
      const std::int32_t owner = owners_[static_cast<std::size_t>(contact.collider)];
      if (owner < 0) continue;
      const std::size_t b = static_cast<std::size_t>(owner);
      const Vec impulse = contact.correction * -mass;
      impulses[b] = impulses[b] + impulse;
      twists[b] = twists[b] + cross(contact.point, impulse);
    }
    for (std::size_t b = 0; b < bodies_.size(); ++b) {
      Body& body = bodies_[b];
      const double all[6] = {impulses[b].x, impulses[b].y, impulses[b].z,
                             twists[b].x,   twists[b].y,   twists[b].z};
      for (int k = 0; k < 6; ++k)
        body.impulse[k] += all[k], body.delayed[k] += all[k] * remaining_fraction * step_;
      const Vec centre = body.begin + (body.end - body.begin) * fraction + body.shift;
      body.velocity = body.velocity + impulses[b] * body.inverse_mass;
      body.spin = body.spin + body.angular_change(twists[b] - cross(centre, impulses[b]));
      body.shift = body.shift + body.velocity * h;
      body.rotation = body.rotation + body.spin * h;
    }
  }

  // The padding particle of neighbour lists.
  static constexpr double PADDING_POSITION = 1e30;
  // Over squared spacing / viscosity.
  static constexpr double VISCOUS_LIMIT = 0.1;
  // Over the square root of mass / tension.
  static constexpr double CAPILLARY_LIMIT = 0.5;

  const FluidFunctions& loops_ =
      fluid_in_quads() ? *fluid_in_quads() : FluidLoops<Plain>::functions;
  const FluidRule rule_;
  const double sound_;
  double relaxation_ = 0;
  const std::vector<Collider> colliders_;
  const std::vector<std::int32_t> owners_;
  std::vector<Body> bodies_;
  const double step_, radius_, lattice_;
  std::size_t count_ = 0;
  bool listed_ = false;
  double compression_ = 0, extent_ = 0;
  Film film_{rule_.spacing};
  Vec middle_;
  // All in grid order; `order_` maps to the original order.
  std::vector<std::int32_t> order_, partners_;
  std::vector<std::size_t> neighbour_starts_, contact_starts_;
  std::vector<double> factor_, squares_, excess_densities_, pressure_, virial_;
  std::vector<Row> point_, before_, velocity_, accelerations_, corrections_, sums_, listed_at_;
  std::vector<ColliderContact> contacts_;
  std::vector<Pose> poses_, old_poses_, listed_poses_;
};

}  // namespace

}  // namespace fluid

namespace {

fluid::FluidRule rule_of(double spacing, double density, double viscosity, double tension) {
  check::positive("spacing", spacing);
  check::positive("density", density);
  check::not_negative("viscosity", viscosity);
  check::not_negative("tension", tension);
  return {spacing, density, viscosity, tension};
}

}  // namespace

FluidStepped fluid_steps(ColliderArrays colliders, In<std::int32_t, 1> owners, In<double, 2> bodies,
                         In<double, 3> state, In<double, 2> accelerations, double spacing,
                         double density, double viscosity, double tension, double sound,
                         double step, std::int64_t substeps) {
  const std::size_t count = state.shape(1), pushed = bodies.shape(0);
  std::vector<collide::Collider> shapes = read_colliders(colliders);
  check::shape("owners", owners, {shapes.size()});
  check::shape("bodies", bodies, {pushed, 13});
  check::indices("owners", owners, -1, static_cast<std::int64_t>(pushed));
  check::finite("bodies", bodies);
  check::shape("state", state, {2, check::ANY, 3});
  check::shape("accelerations", accelerations, {count, 3});
  check::at_most("state", count, check::MAX_ROWS);
  check::positive("sound", sound);
  check::positive("step", step);
  check::between("substeps", substeps, 1, 1 << 24);
  const fluid::FluidRule rule = rule_of(spacing, density, viscosity, tension);
  std::vector<fluid::Body> moved(pushed);
  for (std::size_t b = 0; b < pushed; ++b) {
    const double* row = bodies.data() + 13 * b;
    moved[b].inverse_mass = row[0];
    std::copy_n(row + 1, 6, moved[b].inverse_inertia);
    moved[b].begin = collide::load(row + 7), moved[b].end = collide::load(row + 10);
  }
  Out<double, 3> result(2, count, 3), wrenches(2, pushed, 6);
  Out<double, 1> pressures(count);
  double compression = 0;
  fluid::Steps steps(rule, std::move(shapes), {owners.data(), owners.data() + owners.size()},
                     std::move(moved), step, sound);
  steps.begin(state.data(), accelerations.data(), count);
  steps.run(static_cast<std::size_t>(substeps));
  steps.store_state(result.get(), pressures.get());
  compression = steps.compression();
  for (std::size_t b = 0; b < pushed; ++b) {
    std::copy_n(steps.bodies()[b].impulse, 6, wrenches.get() + 6 * b);
    std::copy_n(steps.bodies()[b].delayed, 6, wrenches.get() + 6 * (pushed + b));
  }
  return {std::move(result), std::move(pressures), std::move(wrenches), compression};
}

Out<double, 1> fluid_densities(ColliderArrays colliders, In<double, 2> points, double spacing) {
  const std::size_t count = points.shape(0);
  std::vector<collide::Collider> shapes = read_colliders(colliders);
  check::shape("points", points, {check::ANY, 3});
  check::at_most("points", count, check::MAX_ROWS);
  const fluid::FluidRule rule = rule_of(spacing, 1, 0, 0);
  Out<double, 1> result(count);
  const std::vector<std::int32_t> owners(shapes.size(), -1);
  fluid::Steps steps(rule, std::move(shapes), owners, {}, 1, 1);
  std::vector<double> state(6 * count, 0.0), none(3 * count, 0.0);
  std::copy_n(points.data(), 3 * count, state.data());
  steps.begin(state.data(), none.data(), count);
  steps.densities(result.get());
  return result;
}

double fluid_area(In<double, 2> points, double spacing) {
  const std::size_t count = points.shape(0);
  check::shape("points", points, {check::ANY, 3});
  check::at_most("points", count, check::MAX_ROWS);
  check::positive("spacing", spacing);
  std::vector<double> rows(4 * count);
  for (std::size_t i = 0; i < count; ++i) std::copy_n(points.data() + 3 * i, 3, &rows[4 * i]);
  fluid::Film film(spacing);
  film.list(rows.data(), count);
  return film.measure(rows.data(), count);
}

}  // namespace animtool
