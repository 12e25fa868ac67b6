// Checks of arguments, and their error messages.
#include "base/checks.h"

#include <cmath>
#include <cstdio>
#include <stdexcept>

namespace animtool::check {

namespace {

// Whether all elements pass a test. Works without branches, with integers of the same width as the
// elements, so that the loop vectorises.
template <class T, class Test>
bool all_pass(const T* values, std::size_t begin, std::size_t end, Test passes_test) {
  using Count = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
  Count has_failure = 0;
  for (std::size_t i = begin; i < end; ++i)
    has_failure |= static_cast<Count>(!passes_test(values + i));
  return !has_failure;
}

}  // namespace

void refuse(const char* name, const std::string& message) {
  throw std::invalid_argument(std::string(name) + ": " + message);
}

std::string number_text(double value) {
  char digits[40];
  std::snprintf(digits, sizeof digits, "%.9g", value);
  return digits;
}
std::string number_text(std::int64_t value) { return std::to_string(value); }
std::string number_text(std::uint64_t value) { return std::to_string(value); }

void shape(const char* name, const std::size_t* actual_sizes, std::size_t axes, const void* data,
           std::size_t alignment, std::initializer_list<std::size_t> sizes) {
  bool is_match = axes == sizes.size();
  const std::size_t* actual_size = actual_sizes;
  for (const std::size_t size : sizes) {
    is_match = is_match && (size == ANY || *actual_size == size);
    ++actual_size;
  }
  if (!is_match) {
    std::string actual_text, expected_text;
    for (std::size_t i = 0; i < axes; ++i) actual_text += (i ? ", " : "") + text(actual_sizes[i]);
    for (const std::size_t size : sizes)
      expected_text += (expected_text.empty() ? "" : ", ") + (size == ANY ? "any" : text(size));
    refuse(name, "shape (" + actual_text + ") is not (" + expected_text + ")");
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

void at_most(const char* name, std::size_t rows, std::size_t max_rows) {
  if (rows > max_rows) refuse(name, text(rows) + " rows are more than " + text(max_rows));
}

void finite(const char* name, double value) {
  if (!std::isfinite(value)) refuse(name, text(value) + " is not finite");
}

void positive(const char* name, double value) {
  if (!(std::isfinite(value) && value > 0))
    refuse(name, text(value) + " is not above 0 and finite");
}

void non_negative(const char* name, double value) {
  if (!(std::isfinite(value) && value >= 0))
    refuse(name, text(value) + " is not 0 or more and finite");
}

template <class T>
void finite(const char* name, const T* values, std::size_t count) {
  constexpr T max_value = std::numeric_limits<T>::max();
  if (all_pass(values, 0, count, [](const T* value) { return std::fabs(*value) <= max_value; }))
    return;
  for (std::size_t i = 0; i < count; ++i)
    if (!std::isfinite(values[i]))
      refuse(name, text(values[i]) + " at index " + text(i) + " is not finite");
}

template void finite(const char*, const float*, std::size_t);
template void finite(const char*, const double*, std::size_t);

template <class T>
void indices(const char* name, const T* values, std::size_t count, std::int64_t low,
             std::int64_t end) {
  constexpr std::int64_t max_value = std::numeric_limits<T>::max();
  const T min_index = static_cast<T>(low),
          max_index = static_cast<T>(end - 1 < max_value ? end - 1 : max_value);
  const auto is_valid = [&](const T* value) {
    return (*value >= min_index) & (*value <= max_index);
  };
  if (all_pass(values, 0, count, is_valid)) return;
  for (std::size_t i = 0; i < count; ++i) {
    if (is_valid(values + i)) continue;
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
  const auto is_ordered = [](const T* value) { return value[0] >= value[-1]; };
  if (values[0] == values[0] && all_pass(values, 1, count, is_ordered)) return;
  for (std::size_t i = 0; i < count; ++i)
    if (!(i ? is_ordered(values + i) : values[0] == values[0]))
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
