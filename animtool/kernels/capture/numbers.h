// Reading a decimal number from text, correctly rounded and without a locale.
#pragma once

#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <system_error>

#if !defined(__cpp_lib_to_chars)
#include <locale.h>
#include <stdlib.h>
#if defined(__APPLE__)
#include <xlocale.h>
#endif
#endif

namespace animtool {

// Kinds of numbers in a text.
enum class NumberKind { finite, not_finite, overflow, malformed };

inline bool is_digit(char c) { return static_cast<unsigned char>(c - '0') < 10; }

inline bool equals_ignoring_case(const char* p, const char* end, const char* word) {
  for (; *word; ++p, ++word) {
    if (p == end || (*p | 0x20) != *word) return false;
  }
  return p == end;
}

// Whether a token is nan, inf or infinity of C, or a spelling of older Microsoft runtimes (1.#QNAN,
// 1.#IND, 1.#INF).
inline bool is_not_finite(const char* p, const char* end) {
  if (p != end && (*p == '-' || *p == '+')) ++p;
  if (end - p >= 3 && p[0] == '1' && p[1] == '.' && p[2] == '#') return true;
  return equals_ignoring_case(p, end, "nan") || equals_ignoring_case(p, end, "inf") ||
         equals_ignoring_case(p, end, "infinity") || equals_ignoring_case(p, end, "nan(ind)") ||
         equals_ignoring_case(p, end, "nan(snan)");
}

// Reads a number with more digits than 53 bits hold, or a large exponent. The token must be well
// formed.
inline NumberKind read_general_number(const char* p, const char* end, double& value) {
  if (*p == '+') ++p;
#if defined(__cpp_lib_to_chars)
  const auto result = std::from_chars(p, end, value);
  if (result.ec == std::errc()) return NumberKind::finite;
  // from_chars does not set the value if it is out of range, on either side: the position of the
  // first nonzero digit and the exponent tell on which side it is.
  const bool is_negative = *p == '-';
  std::int64_t position = 0, exponent = 0;
  bool has_nonzero_digit = false, is_after_point = false;
  const char* d = p + is_negative;
  for (; d != end && (*d | 0x20) != 'e'; ++d) {
    if (*d == '.') {
      is_after_point = true;
    } else if (is_after_point) {
      if (!has_nonzero_digit) --position;
      has_nonzero_digit |= *d != '0';
    } else {
      has_nonzero_digit |= *d != '0';
      position += has_nonzero_digit;
    }
  }
  if (d != end) {
    const bool is_negative_exponent = *++d == '-';
    if (*d == '-' || *d == '+') ++d;
    for (; d != end && exponent < 1000000; ++d) exponent = exponent * 10 + (*d - '0');
    if (is_negative_exponent) exponent = -exponent;
  }
  const bool is_underflow = position + exponent <= 0;
#else
#if defined(_WIN32)
  static const _locale_t c_locale = _create_locale(LC_ALL, "C");
  value = _strtod_l(std::string(p, end).c_str(), nullptr, c_locale);
#else
  static const locale_t c_locale = newlocale(LC_ALL_MASK, "C", nullptr);
  value = strtod_l(std::string(p, end).c_str(), nullptr, c_locale);
#endif
  if (std::isfinite(value)) return NumberKind::finite;
  const bool is_negative = *p == '-';
  const bool is_underflow = false;
#endif
  if (is_underflow) {
    value = is_negative ? -0.0 : 0.0;
    return NumberKind::finite;
  }
  value = is_negative ? -std::numeric_limits<double>::infinity()
                      : std::numeric_limits<double>::infinity();
  return NumberKind::overflow;
}

// Appends the digits at p to the mantissa, eight at a time where eight bytes can be read: a bit
// scan finds the first byte that is not a digit, and three multiplications sum the digits before it
// in pairs, fours and eights (D. Lemire, Number parsing at a gigabyte per second, 2021).
inline void read_digits(const char*& p, const char* end, std::uint64_t& mantissa) {
  static constexpr std::uint64_t kTens[] = {1,      10,      100,      1000,     10000,
                                            100000, 1000000, 10000000, 100000000};
  if constexpr (std::endian::native == std::endian::little) {
    while (end - p >= 8) {
      std::uint64_t word;
      std::memcpy(&word, p, 8);
      word ^= 0x3030303030303030u;
      const std::uint64_t other_bytes = ((word + 0x0606060606060606u) | word) & 0xF0F0F0F0F0F0F0F0u;
      const int count = other_bytes ? std::countr_zero(other_bytes) / 8 : 8;
      if (count == 0) return;
      word <<= 64 - 8 * count;
      word = (word * 10) + (word >> 8);
      word = (((word & 0x000000FF000000FFu) * 0x000F424000000064u) +
              (((word >> 16) & 0x000000FF000000FFu) * 0x0000271000000001u)) >>
             32;
      mantissa = mantissa * kTens[count] + word;
      p += count;
      if (count < 8) return;
    }
  }
  while (is_digit(*p)) mantissa = mantissa * 10 + static_cast<unsigned>(*p++ - '0');
}

// Reads the token that starts at p; on return p is one past its last character. A token ends at a
// blank, a line end, or `end`, where the text has a zero byte (as Python's bytes do), so that runs
// of digits need no second test.
//
// Clinger's fast path: a mantissa below 2^53 and a power of ten up to 10^22 are
// both exact doubles, so one multiplication or division rounds correctly
// (W. D. Clinger, How to read floating point numbers accurately, 1990).
inline NumberKind read_number(const char*& p, const char* end, double& value) {
  static constexpr double kPowersOfTen[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                            1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                            1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  const char* const start = p;
  const bool is_negative = *p == '-';
  p += is_negative | (*p == '+');

  std::uint64_t mantissa = 0;
  const char* const digits = p;
  read_digits(p, end, mantissa);
  std::ptrdiff_t digit_count = p - digits;
  std::ptrdiff_t fraction_digit_count = 0;
  if (*p == '.') {
    const char* const first = ++p;
    read_digits(p, end, mantissa);
    fraction_digit_count = p - first;
    digit_count += fraction_digit_count;
  }
  bool is_well_formed = digit_count > 0;
  std::int64_t exponent = 0;
  if (is_well_formed && (*p | 0x20) == 'e') {
    ++p;
    bool is_negative_exponent = false;
    if (*p == '-' || *p == '+') is_negative_exponent = *p++ == '-';
    is_well_formed = is_digit(*p);
    while (is_digit(*p)) {
      if (exponent < 100000) exponent = exponent * 10 + (*p - '0');
      ++p;
    }
    if (is_negative_exponent) exponent = -exponent;
  }
  const auto is_at_end = [&] {
    return *p == ' ' || *p == '\n' || *p == '\t' || *p == '\r' || p == end;
  };
  if (!is_well_formed || !is_at_end()) {
    while (!is_at_end()) ++p;
    if (!is_not_finite(start, p)) return NumberKind::malformed;
    value = std::numeric_limits<double>::quiet_NaN();
    return NumberKind::not_finite;
  }

  // 19 digits cannot overflow 64 bits, so this comparison uses all of them.
  constexpr std::uint64_t kExactMantissa = std::uint64_t{1} << 53;
  const std::int64_t decimal_exponent = exponent - fraction_digit_count;
  if (digit_count <= 19 && mantissa <= kExactMantissa && decimal_exponent >= -22 &&
      decimal_exponent <= 22) {
    double v = static_cast<double>(mantissa);
    v = decimal_exponent <= 0 ? v / kPowersOfTen[-decimal_exponent]
                              : v * kPowersOfTen[decimal_exponent];
    value = std::copysign(v, is_negative ? -1.0 : 1.0);
    return NumberKind::finite;
  }
  return read_general_number(start, p, value);
}

}  // namespace animtool
