// Checks of arguments, and their error messages.
#include "base/checks.h"

#include <cmath>
#include <cstdio>
#include <stdexcept>

namespace animtool::check {

namespace {

// Whether all elements pass a test. Works without branches, with integers of the same width as the
// elements, so that the loop vectorises.
template <class T, class Good>
bool all(const T* values, std::size_t begin, std::size_t end, Good good) {
  using Count = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
  Count bad = 0;
  for (std::size_t i = begin; i < end; ++i) bad |= static_cast<Count>(!good(values + i));
  return !bad;
}

}  // namespace

void refuse(const char* name, const std::string& what) {
  throw std::invalid_argument(std::string(name) + ": " + what);
}

std::string number_text(double value) {
  char digits[40];
  std::snprintf(digits, sizeof digits, "%.9g", value);
  return digits;
}
std::string number_text(std::int64_t value) { return std::to_string(value); }
std::string number_text(std::uint64_t value) { return std::to_string(value); }

void shape(const char* name, const std::size_t* actual, std::size_t axes, const void* data,
           std::size_t alignment, std::initializer_list<std::size_t> sizes) {
  bool fits = axes == sizes.size();
  const std::size_t* at = actual;
  for (const std::size_t size : sizes) {
    fits = fits && (size == ANY || *at == size);
    ++at;
  }
  if (!fits) {
    std::string there, asked;
    for (std::size_t i = 0; i < axes; ++i) there += (i ? ", " : "") + text(actual[i]);
    for (const std::size_t size : sizes)
      asked += (asked.empty() ? "" : ", ") + (size == ANY ? "any" : text(size));
    refuse(name, "shape (" + there + ") is not (" + asked + ")");
  }
  if (reinterpret_cast<std::uintptr_t>(data) % alignment) refuse(name, "the array is not aligned");
}

template <class T>
void refuse_range(const char* name, T value, T low, T high) {
  refuse(name,
         number_text(value) + " is not between " + number_text(low) + " and " + number_text(high));
}

template void refuse_range(const char*, double, double, double);
template void refuse_range(const char*, std::int64_t, std::int64_t, std::int64_t);
template void refuse_range(const char*, std::uint64_t, std::uint64_t, std::uint64_t);

void at_most(const char* name, std::size_t rows, std::size_t most) {
  if (rows > most) refuse(name, text(rows) + " rows are more than " + text(most));
}

void finite(const char* name, double value) {
  if (!std::isfinite(value)) refuse(name, text(value) + " is not finite");
}

void positive(const char* name, double value) {
  if (!(std::isfinite(value) && value > 0))
    refuse(name, text(value) + " is not above 0 and finite");
}

void not_negative(const char* name, double value) {
  if (!(std::isfinite(value) && value >= 0))
    refuse(name, text(value) + " is not 0 or more and finite");
}

template <class T>
void finite(const char* name, const T* values, std::size_t count) {
  constexpr T most = std::numeric_limits<T>::max();
  if (all(values, 0, count, [](const T* at) { return std::fabs(*at) <= most; })) return;
  for (std::size_t i = 0; i < count; ++i)
    if (!std::isfinite(values[i]))
      refuse(name, text(values[i]) + " at index " + text(i) + " is not finite");
}

template void finite(const char*, const float*, std::size_t);
template void finite(const char*, const double*, std::size_t);

template <class T>
void indices(const char* name, const T* values, std::size_t count, std::int64_t low,
             std::int64_t end) {
  constexpr std::int64_t most = std::numeric_limits<T>::max();
  const T least = static_cast<T>(low), last = static_cast<T>(end - 1 < most ? end - 1 : most);
  const auto good = [&](const T* at) { return (*at >= least) & (*at <= last); };
  if (all(values, 0, count, good)) return;
  for (std::size_t i = 0; i < count; ++i) {
    if (good(values + i)) continue;
    if (end <= low) refuse(name, text(values[i]) + " where nothing can be named");
    refuse(name, text(values[i]) + " is not between " + text(low) + " and " + text(end - 1));
  }
}

template void indices(const char*, const std::uint8_t*, std::size_t, std::int64_t, std::int64_t);
template void indices(const char*, const std::int32_t*, std::size_t, std::int64_t, std::int64_t);
template void indices(const char*, const std::int64_t*, std::size_t, std::int64_t, std::int64_t);

template <class T>
void ascending(const char* name, const T* values, std::size_t count) {
  if (!count) return;
  const auto good = [](const T* at) { return at[0] >= at[-1]; };
  if (values[0] == values[0] && all(values, 1, count, good)) return;
  for (std::size_t i = 0; i < count; ++i)
    if (!(i ? good(values + i) : values[0] == values[0]))
      refuse(name, "it does not ascend at index " + text(i));
}

template void ascending(const char*, const double*, std::size_t);
template void ascending(const char*, const std::int32_t*, std::size_t);
template void ascending(const char*, const std::int64_t*, std::size_t);

template <class T>
void starts(const char* name, const T* first, std::size_t rows, std::size_t length) {
  if (!rows || first[0] != 0 || first[rows - 1] != static_cast<std::int64_t>(length))
    refuse(name, "it does not go from 0 to " + text(length));
  ascending(name, first, rows);
}

template void starts(const char*, const std::int32_t*, std::size_t, std::size_t);
template void starts(const char*, const std::int64_t*, std::size_t, std::size_t);

}  // namespace animtool::check
