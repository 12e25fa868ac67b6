// Forces of springs, anchors and air.
#include "springs/network.h"

#include <algorithm>
#include <array>
#include <utility>

#include "base/checks.h"
#include "base/groups.h"
#include "springs/loops.h"

namespace animtool {

namespace {

// Checks and converts indices of particles.
std::vector<std::int32_t> read_particle_indices(const char* name, const std::int64_t* values,
                                                std::size_t size, std::size_t particles) {
  check::indices(name, values, size, 0, static_cast<std::int64_t>(particles));
  return {values, values + size};
}

// Checks and copies a path of points.
Track read_track(const char* name, const In<double, 3>& path, std::size_t points,
                 std::size_t knot_count) {
  check::shape(name, path, {path.shape(0) == 1 ? 1 : knot_count, points, 3});
  check::finite(name, path);
  return {{path.data(), path.data() + path.size()}, points, path.shape(0) == 1};
}

// Checks that the numbers of a column of springs are not negative.
void check_column(const char* name, const In<double, 1>& column, std::size_t spring_count,
                  bool requires_finite = true) {
  check::shape(name, column, {spring_count});
  for (std::size_t s = 0; s < spring_count; ++s) {
    const double value = column.data()[s];
    if (requires_finite) check::non_negative(name, value);
    if (!(value >= 0)) check::refuse(name, check::text(value) + " is not 0 or more");
  }
}

std::vector<double> finite_column(const char* name, const In<double, 1>& column, std::size_t size) {
  check::shape(name, column, {size});
  check::finite(name, column);
  return {column.data(), column.data() + column.size()};
}

std::vector<double> to_vector(const In<double, 1>& column) {
  return {column.data(), column.data() + column.size()};
}

}  // namespace

SpringNetwork::SpringNetwork(const SpringArrays& arrays)
    : SpringElements{to_vector(arrays.inverse_masses), {}, {}, 0},
      drags(to_vector(arrays.drags)),
      air_drag(arrays.air_drag),
      air_lift(arrays.air_lift),
      knot_times(to_vector(arrays.knots)) {
  const auto& [masses, particle_drags, ends, rest_lengths, stiffness, damping, limit, faces,
               gravity_vector, drag_coefficient, lift_coefficient, times, pins, pinned_path,
               anchor_particles, anchor_stiffnesses, anchor_dampings, anchor_path, winds] = arrays;
  const std::size_t count = inverse_masses.size(), spring_count = ends.shape(0);
  check::shape("inverse_masses", masses, {count});
  check::at_most("inverse_masses", count, check::MAX_ROWS);
  for (const double inverse : inverse_masses) check::non_negative("inverse_masses", inverse);
  check::numbers("drags", particle_drags, {count});
  check::shape("ends", ends, {check::ANY, 2});
  check::at_most("ends", spring_count, check::MAX_ROWS);
  check::indices("ends", ends, 0, static_cast<std::int64_t>(count));
  check_column("rest", rest_lengths, spring_count);
  check_column("stiffness", stiffness, spring_count);
  check_column("damping", damping, spring_count);
  check_column("limit", limit, spring_count, false);
  check::shape("triangles", faces, {check::ANY, 3});
  check::at_most("triangles", faces.shape(0), check::MAX_ROWS);
  check::numbers("gravity", gravity_vector, {3});
  check::finite("air_drag", drag_coefficient);
  check::finite("air_lift", lift_coefficient);
  check::shape("knots", times, {check::ANY});
  if (knot_times.empty()) check::refuse("knots", "there is none");
  check::finite("knots", times);
  check::ascending("knots", knot_times.data(), knot_times.size());
  check::shape("pinned", pins, {check::ANY});
  check::shape("anchors", anchor_particles, {check::ANY});
  anchor_stiffness =
      finite_column("anchor_stiffness", anchor_stiffnesses, anchor_particles.shape(0));
  anchor_damping = finite_column("anchor_damping", anchor_dampings, anchor_particles.shape(0));
  for (std::size_t s = 0; s < spring_count; ++s) {
    const std::int64_t* pair = ends.data() + 2 * s;
    spring_set.springs.push_back({static_cast<std::int32_t>(pair[0]),
                                  static_cast<std::int32_t>(pair[1]), rest_lengths.data()[s],
                                  stiffness.data()[s], damping.data()[s], limit.data()[s]});
    spring_set.indices.push_back(static_cast<std::int32_t>(s));
  }
  spring_set.prepare(count);
  triangles = read_particle_indices("triangles", faces.data(), faces.size(), count);
  std::copy_n(gravity_vector.data(), 3, gravity);
  pinned_particles = read_particle_indices("pinned", pins.data(), pins.size(), count);
  pinned_track = read_track("pinned_path", pinned_path, pinned_particles.size(), knot_times.size());
  anchors =
      read_particle_indices("anchors", anchor_particles.data(), anchor_particles.size(), count);
  anchor_track = read_track("anchor_path", anchor_path, anchors.size(), knot_times.size());
  wind_track = read_track("winds", winds, 1, knot_times.size());
  collect_edges();
}

void SpringNetwork::collect_edges() {
  std::vector<std::array<std::int32_t, 2>> edge_pairs;
  for (std::size_t t = 0; t < triangles.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [i, j] = std::minmax(triangles[t + k], triangles[t + (k + 1) % 3]);
      edge_pairs.push_back({i, j});
    }
  // Without triangles these are ropes and strands: springs between consecutive particles.
  for (std::size_t s = 0; triangles.empty() && s < spring_set.springs.size(); ++s) {
    const auto [i, j] = std::minmax(spring_set.springs[s].i, spring_set.springs[s].j);
    if (j == i + 1) edge_pairs.push_back({i, j});
  }
  std::sort(edge_pairs.begin(), edge_pairs.end());
  edge_pairs.erase(std::unique(edge_pairs.begin(), edge_pairs.end()), edge_pairs.end());
  for (const auto& edge : edge_pairs) edges.insert(edges.end(), edge.begin(), edge.end());
  if (edge_pairs.empty()) return;
  for (const Spring& spring : spring_set.springs) {
    if (!(spring.rest_length > longest_edge)) continue;
    const auto [i, j] = std::minmax(spring.i, spring.j);
    if (std::binary_search(edge_pairs.begin(), edge_pairs.end(), std::array<std::int32_t, 2>{i, j}))
      longest_edge = spring.rest_length;
  }
}

void SpringNetwork::set_paths(In<double, 3> pinned_path, In<double, 3> anchor_path) {
  Track new_pinned_track =
      read_track("pinned_path", pinned_path, pinned_particles.size(), knot_times.size());
  anchor_track = read_track("anchor_path", anchor_path, anchors.size(), knot_times.size());
  pinned_track = std::move(new_pinned_track);
}

KnotInterval find_knot_interval(const std::vector<double>& knot_times, double t) {
  if (knot_times.size() == 1 || t <= knot_times.front()) return {0, 0.0};
  if (t >= knot_times.back()) return {knot_times.size() - 1, 0.0};
  const auto after = std::upper_bound(knot_times.begin(), knot_times.end(), t);
  const std::size_t row = static_cast<std::size_t>(after - knot_times.begin()) - 1;
  return {row, (t - knot_times[row]) / (knot_times[row + 1] - knot_times[row])};
}

void SpringNetwork::sample_track(const Track& track, const KnotInterval& interval, double* out) {
  const std::size_t width = 3 * track.points;
  const double* a = track.positions.data() + (track.is_constant ? 0 : interval.knot_index * width);
  if (track.is_constant || interval.fraction == 0) {
    std::copy_n(a, width, out);
    return;
  }
  for (std::size_t k = 0; k < width; ++k) out[k] = a[k] + (a[width + k] - a[k]) * interval.fraction;
}

void SpringNetwork::add_anchor_forces(const double* anchor_points, const double* anchor_velocities,
                                      const double* x, const double* v, double* forces) const {
  for (std::size_t a = 0; a < anchors.size(); ++a) {
    const std::size_t row = PARTICLE_STRIDE * static_cast<std::size_t>(anchors[a]);
    for (std::size_t k = 0; k < 3; ++k)
      forces[row + k] += anchor_stiffness[a] * (anchor_points[3 * a + k] - x[row + k]) +
                         anchor_damping[a] * (anchor_velocities[3 * a + k] - v[row + k]);
  }
}

void SpringNetwork::add_air_forces(const double* wind, const double* x, const double* v,
                                   double* forces) const {
  if (air_drag == 0 && air_lift == 0) return;
  for (std::size_t t = 0; t < triangles.size(); t += 3) {
    const std::size_t corners[3] = {PARTICLE_STRIDE * static_cast<std::size_t>(triangles[t]),
                                    PARTICLE_STRIDE * static_cast<std::size_t>(triangles[t + 1]),
                                    PARTICLE_STRIDE * static_cast<std::size_t>(triangles[t + 2])};
    double a[3], b[3], flow[3];
    for (std::size_t k = 0; k < 3; ++k) {
      a[k] = x[corners[1] + k] - x[corners[0] + k];
      b[k] = x[corners[2] + k] - x[corners[0] + k];
      flow[k] = wind[k] - (v[corners[0] + k] + v[corners[1] + k] + v[corners[2] + k]) / 3;
    }
    // Twice the area, along the normal.
    const double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                         a[0] * b[1] - a[1] * b[0]};
    const double doubled_area = std::sqrt(dot3(n, n)), speed = std::sqrt(dot3(flow, flow));
    if (!(doubled_area > 0) || !(speed > 0)) continue;
    const double normal_speed = dot3(flow, n) / doubled_area;
    const double drag_scale =
        air_drag * std::abs(normal_speed) - air_lift * normal_speed * normal_speed / speed;
    const double lift_scale = air_lift * normal_speed * speed / doubled_area;
    for (std::size_t k = 0; k < 3; ++k) {
      // Each corner gets a third of the force.
      const double force = (drag_scale * flow[k] + lift_scale * n[k]) * (doubled_area / 6);
      for (const std::size_t corner : corners) forces[corner + k] += force;
    }
  }
}

void SpringNetwork::set_pinned(double t, double h, const double* before, double* x, double* v,
                               const Strides& strides) const {
  if (pinned_particles.empty()) return;
  const KnotInterval interval = interval_at(t);
  const std::size_t width = 3 * pinned_particles.size();
  const double* a =
      pinned_track.positions.data() + (pinned_track.is_constant ? 0 : interval.knot_index * width);
  const bool is_interpolated = !pinned_track.is_constant && interval.fraction != 0;
  for (std::size_t p = 0; p < pinned_particles.size(); ++p)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t index =
          strides.particle * static_cast<std::size_t>(pinned_particles[p]) + strides.component * k;
      double coordinate = a[3 * p + k];
      if (is_interpolated) coordinate += (a[width + 3 * p + k] - coordinate) * interval.fraction;
      v[index] = (coordinate - before[index]) / h;
      x[index] = coordinate;
    }
}

SpringRun::SpringRun(const SpringNetwork& network, const double* x0, const double* v0,
                     const std::uint8_t* is_torn0)
    : network(network),
      size(PARTICLE_STRIDE * network.particle_count()),
      x(size),
      v(size),
      is_torn(is_torn0, is_torn0 + network.spring_set.springs.size()),
      anchor_points(3 * network.anchors.size()),
      anchor_points_before(3 * network.anchors.size()),
      anchor_velocities(3 * network.anchors.size()) {
  for (std::size_t n = 0; n < network.particle_count(); ++n) {
    std::copy_n(x0 + 3 * n, 3, x.data() + PARTICLE_STRIDE * n);
    std::copy_n(v0 + 3 * n, 3, v.data() + PARTICLE_STRIDE * n);
  }
  if (std::find(is_torn.begin(), is_torn.end(), 1) != is_torn.end()) remove_torn();
}

bool SpringRun::tear() {
  if (!spring_set().can_tear) return false;
  bool has_torn = false;
  const SpringSet& current = spring_set();
  for (std::size_t s = 0; s < current.springs.size(); ++s) {
    const Spring& spring = current.springs[s];
    const double* p = x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
    const double* q = x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
    const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    if (!(dot3(d, d) > spring.tear_length * spring.tear_length)) continue;
    is_torn[static_cast<std::size_t>(current.indices[s])] = 1;
    has_torn = true;
  }
  if (has_torn) remove_torn();
  return has_torn;
}

void SpringRun::remove_torn() {
  SpringSet remaining;
  for (std::size_t s = 0; s < is_torn.size(); ++s) {
    if (is_torn[s]) continue;
    remaining.springs.push_back(network.spring_set.springs[s]);
    remaining.indices.push_back(static_cast<std::int32_t>(s));
  }
  remaining.prepare(network.particle_count());
  intact_spring_set_ = std::move(remaining);
}

void SpringSet::prepare(std::size_t particles) {
  forces = SpringForces(springs, particles);
  const std::size_t count = springs.size();
  for (const Spring& spring : springs) {
    ends.push_back(spring.i);
    ends.push_back(spring.j);
    rest_lengths.push_back(spring.rest_length);
    can_tear = can_tear || std::isfinite(spring.tear_length);
  }
  const auto is_independent = [&](std::size_t s) {
    if (s + SIMD_WIDTH > count) return false;
    for (std::size_t a = 2 * s; a < 2 * (s + SIMD_WIDTH); ++a)
      for (std::size_t b = 2 * s; b < a; ++b)
        if (ends[a] == ends[b]) return false;
    return true;
  };
  for (std::size_t s = 0; s < count;) {
    SpringRunLength run{s, 0, 0};
    for (; is_independent(s); s += SIMD_WIDTH) ++run.group_count;
    for (; s < count && !is_independent(s); ++s) ++run.single_count;
    runs.push_back(run);
  }
}

void SpringRun::sample_surroundings(double t, double h) {
  const KnotInterval interval = network.interval_at(t);
  SpringNetwork::sample_track(network.wind_track, interval, wind);
  if (network.anchors.empty()) return;
  SpringNetwork::sample_track(network.anchor_track, interval, anchor_points.data());
  if (network.anchor_track.is_constant) {
    anchor_points_before = anchor_points;
    return;
  }
  SpringNetwork::sample_track(network.anchor_track, network.interval_at(t - h),
                              anchor_points_before.data());
  for (std::size_t k = 0; k < anchor_points.size(); ++k)
    anchor_velocities[k] = (anchor_points[k] - anchor_points_before[k]) / h;
}

bool SpringRun::has_other_forces() const {
  const bool has_air_forces = network.air_drag != 0 || network.air_lift != 0;
  return spring_set().forces.has_unbanded() || !network.anchors.empty() || has_air_forces;
}

void SpringRun::compute_other_forces(const double* positions, const double* velocities,
                                     double* forces) const {
  std::fill_n(forces, size, 0.0);
  spring_set().forces.add_unbanded(positions, velocities, forces);
  network.add_anchor_forces(anchor_points.data(), anchor_velocities.data(), positions, velocities,
                            forces);
  network.add_air_forces(wind, positions, velocities, forces);
}

void SpringRun::accelerate(const double* positions, const double* velocities, double* out) {
  spring_set().forces.compute(positions, velocities, buffers_, out);
  network.add_anchor_forces(anchor_points.data(), anchor_velocities.data(), positions, velocities,
                            out);
  network.add_air_forces(wind, positions, velocities, out);
  const double padded_gravity[PARTICLE_STRIDE] = {network.gravity[0], network.gravity[1],
                                                  network.gravity[2], 0};
  const ParticleColumns particles{network.inverse_masses.data(), network.drags.data()};
  spring_functions().accelerate(particles, network.particle_count(), padded_gravity, velocities,
                                out);
}

namespace {

// Smallest and largest number of springs in a block: springs solved together are close in memory.
constexpr std::int64_t MIN_BLOCK_SIZE = 512, MAX_BLOCK_SIZE = 8192;

}  // namespace

std::vector<std::int64_t> order_springs(const std::int64_t* ends, std::size_t spring_count,
                                        std::size_t particle_count) {
  Groups components(particle_count);
  for (std::size_t s = 0; s < spring_count; ++s)
    components.merge(static_cast<std::size_t>(ends[2 * s]),
                     static_cast<std::size_t>(ends[2 * s + 1]));
  const auto low = [&](std::int64_t s) { return std::min(ends[2 * s], ends[2 * s + 1]); };
  std::vector<std::int64_t> spring_components(spring_count);
  for (std::size_t s = 0; s < spring_count; ++s)
    spring_components[s] =
        static_cast<std::int64_t>(components.find_root(static_cast<std::size_t>(ends[2 * s])));
  const auto high = [&](std::int64_t s) { return std::max(ends[2 * s], ends[2 * s + 1]); };
  std::vector<std::int64_t> order(spring_count), spring_levels(spring_count),
      spring_blocks(spring_count);
  for (std::size_t s = 0; s < spring_count; ++s) order[s] = static_cast<std::int64_t>(s);
  std::sort(order.begin(), order.end(), [&](std::int64_t a, std::int64_t b) {
    const auto key = [&](std::int64_t s) {
      return std::array<std::int64_t, 4>{spring_components[static_cast<std::size_t>(s)], low(s),
                                         high(s), s};
    };
    return key(a) < key(b);
  });
  // A spring is solved after the earlier ones that share a particle with it.
  std::vector<std::int64_t> particle_levels(particle_count, 0);
  std::int64_t block_index = 0, block_size = 0, last_component = -1;
  for (const std::int64_t s : order) {
    const std::int64_t spring_component = spring_components[static_cast<std::size_t>(s)];
    if ((spring_component != last_component && block_size >= MIN_BLOCK_SIZE) ||
        block_size >= MAX_BLOCK_SIZE)
      ++block_index, block_size = 0;
    last_component = spring_component;
    ++block_size;
    std::int64_t& a = particle_levels[static_cast<std::size_t>(low(s))];
    std::int64_t& b = particle_levels[static_cast<std::size_t>(high(s))];
    spring_levels[static_cast<std::size_t>(s)] = std::max(a, b);
    spring_blocks[static_cast<std::size_t>(s)] = block_index;
    a = b = std::max(a, b) + 1;
  }
  std::stable_sort(order.begin(), order.end(), [&](std::int64_t a, std::int64_t b) {
    const auto key = [&](std::int64_t s) {
      return std::pair(spring_blocks[static_cast<std::size_t>(s)],
                       spring_levels[static_cast<std::size_t>(s)]);
    };
    return key(a) < key(b);
  });
  return order;
}

}  // namespace animtool
