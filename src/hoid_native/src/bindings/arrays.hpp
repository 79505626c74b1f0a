// Arguments, results and checks of the bindings. An argument of another dtype or shape than the
// kernel's raises a TypeError, one that fails a check a ValueError. One that is not contiguous is
// copied.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "common/image.hpp"

namespace nb = nanobind;

namespace hoid::bindings {

using namespace nb::literals;

// Template arguments of nb::shape; the oldest nanobind, of Ubuntu 24.04, has unsigned ones.
#if NB_VERSION_MAJOR < 2
using Extent = std::size_t;
#else
using Extent = nb::ssize_t;
#endif

template <int... kShape>
using Shape = nb::shape<static_cast<Extent>(kShape)...>;

// How an element is stored: a bool is a byte in NumPy and here.
template <typename T>
using Stored = std::conditional_t<std::is_same_v<T, bool>, uint8_t, T>;

// An argument of exactly this dtype and shape (-1: any length). It converts to what kernels take.
template <typename T, int... kShape>
struct Array
{
  using Imported = nb::ndarray<const T, Shape<kShape...>, nb::c_contig, nb::device::cpu>;

  Imported array;

  int size(int axis = 0) const { return static_cast<int>(array.shape(axis)); }
  int num_elements() const { return static_cast<int>(array.size()); }
  const Stored<T>* begin() const { return reinterpret_cast<const Stored<T>*>(array.data()); }
  const Stored<T>* end() const { return begin() + array.size(); }
  operator const Stored<T>*() const { return begin(); }
  operator Image<T>() const
    requires(sizeof...(kShape) == 2)
  {
    return {begin(), size(1), size(0)};
  }
};

// An argument of any real dtype, converted to double.
template <int... kShape>
struct RealArray : Array<double, kShape...>
{
  operator Boxes() const
    requires(sizeof...(kShape) == 2)
  {
    return {this->begin(), this->size()};
  }
};

template <typename T>
using Vector = Array<T, -1>;
template <typename T>
using ImageArray = Array<T, -1, -1>;
using BoxArray = RealArray<-1, 4>;
using Points = Array<double, -1, 3>;

template <typename T, std::size_t kDimensions>
using Result = nb::ndarray<nb::numpy, T, nb::ndim<kDimensions>>;

// Return an array of this shape to Python, without a copy.
template <typename T, std::size_t kDimensions>
Result<T, kDimensions> give(std::vector<Stored<T>>&& values, const int (&shape)[kDimensions])
{
  using Values = std::vector<Stored<T>>;
  std::array<std::size_t, kDimensions> sizes;
  std::copy(shape, shape + kDimensions, sizes.begin());
  auto* kept = new Values(std::move(values));
  const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<Values*>(p); });
  return {kept->data(), kDimensions, sizes.data(), owner};
}

// Return an array with this many columns to Python: (N,), (N, kColumns) or (N, kColumns, ...).
template <int... kColumns, typename T>
auto give_rows(std::vector<T>&& values)
{
  const int num_rows = static_cast<int>(values.size()) / (1 * ... * kColumns);
  return give<T>(std::move(values), {num_rows, kColumns...});
}

inline auto give_flags(std::vector<uint8_t>&& values)
{
  const int count = static_cast<int>(values.size());
  return give<bool>(std::move(values), {count});
}

// Run a kernel without Python's global lock.
template <typename Kernel>
auto unlocked(Kernel kernel)
{
  const nb::gil_scoped_release release;
  return kernel();
}

// Return an array of this shape, which the kernel writes.
template <typename T, std::size_t kDimensions, typename Kernel>
Result<T, kDimensions> fill(const int (&shape)[kDimensions], Kernel kernel)
{
  std::size_t count = 1;
  for (const int size : shape) {
    count *= size;
  }
  std::vector<Stored<T>> values(count);
  unlocked([&] { kernel(values.data()); });
  return give<T>(std::move(values), shape);
}

template <typename Value>
Value field(Value&& value)
{
  return std::forward<Value>(value);
}

template <typename T>
auto field(std::vector<T>&& values)
{
  return give_rows(std::move(values));
}

// Make the named tuple of hoid_native.results that `Tuple` names. Vectors become arrays (N,).
template <typename Tuple, typename... Fields>
Tuple make(Fields&&... fields)
{
  static const nb::object type = nb::module_::import_("hoid_native.results").attr(Tuple::kName);
  return nb::steal<Tuple>(type(field(std::forward<Fields>(fields))...).release());
}

[[noreturn]] inline void refuse(const std::string& reason)
{
  throw nb::value_error(reason.c_str());
}

inline void require(bool is_true, const char* reason)
{
  if (!is_true) {
    refuse(reason);
  }
}

// Require `length` rows of each named array: require_lengths(3, "k", k, "j", j).
template <typename A, typename... Others>
void require_lengths(int length, const char* name, const A& array, const Others&... others)
{
  if (array.size() != length) {
    refuse(
      std::string(name) + ": expected " + std::to_string(length) + " rows, not " +
      std::to_string(array.size()));
  }
  if constexpr (sizeof...(others) > 0) {
    require_lengths(length, others...);
  }
}

// Require that all values are in [low, end). For types of up to 32 bits, the range must have less
// than 2^32 numbers.
template <typename T, int... kShape>
void require_range(const char* name, const Array<T, kShape...>& array, int64_t low, int64_t end)
{
  // One unsigned comparison per value and no early exit, so that the loop compiles to vector
  // instructions.
  using Unsigned = std::conditional_t<sizeof(T) <= sizeof(uint32_t), uint32_t, uint64_t>;
  const auto first_valid = static_cast<Unsigned>(low), size = static_cast<Unsigned>(end - low);
  Unsigned num_outside = 0;
  for (const T value : array) {
    num_outside += static_cast<Unsigned>(value) - first_valid < size ? 0 : 1;
  }
  if (num_outside > 0) {
    const auto [lowest, highest] = std::minmax_element(array.begin(), array.end());
    refuse(
      std::string(name) + ": " + std::to_string(*lowest) + " to " + std::to_string(*highest) +
      " is not within " + std::to_string(low) + " to " + std::to_string(end - 1));
  }
}

template <typename T, int... kShape>
void require_finite(const char* name, const Array<T, kShape...>& array)
{
  if (!std::all_of(array.begin(), array.end(), [](T value) { return std::isfinite(value); })) {
    refuse(std::string(name) + ": not all are finite");
  }
}

inline void require_pixels(const ImageArray<float>& depth_m)
{
  require(depth_m.num_elements() > 0, "depth_m: the image is empty");
}

// Each binds the kernels of one folder.
void bind_features(nb::module_& module);
void bind_graph(nb::module_& module);
void bind_masks(nb::module_& module);
void bind_matching(nb::module_& module);
void bind_motion(nb::module_& module);
void bind_objects(nb::module_& module);
void bind_optimize(nb::module_& module);

}  // namespace hoid::bindings

// Declares a named tuple of hoid_native.results as a return type.
#define HOID_RESULT(Class)                                                              \
  struct Class : nb::object                                                             \
  {                                                                                     \
    using nb::object::object;                                                           \
    static constexpr const char* kName = #Class;                                        \
    static constexpr auto Name = nb::detail::const_name("hoid_native.results." #Class); \
  }

namespace nanobind::detail {

template <typename T, int... kShape>
struct type_caster<hoid::bindings::Array<T, kShape...>>
{
  using Argument = hoid::bindings::Array<T, kShape...>;
  using Strided = ndarray<const T, hoid::bindings::Shape<kShape...>, device::cpu>;

  NB_TYPE_CASTER(Argument, (make_caster<ndarray<const T, hoid::bindings::Shape<kShape...>>>::Name))

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    constexpr auto kConvert = static_cast<decltype(flags)>(cast_flags::convert);
    make_caster<typename Argument::Imported> exact;
    make_caster<Strided> strided;
    if (
      !exact.from_python(source, flags & ~kConvert, cleanup) &&
      !(strided.from_python(source, flags & ~kConvert, cleanup) &&
        exact.from_python(source, flags | kConvert, cleanup))) {
      return false;
    }
    value.array = std::move(exact.value);
    return true;
  }
};

template <int... kShape>
struct type_caster<hoid::bindings::RealArray<kShape...>>
{
  using Argument = hoid::bindings::RealArray<kShape...>;

  NB_TYPE_CASTER(Argument, const_name("numpy.typing.NDArray[typing.Any]"))

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    make_caster<typename Argument::Imported> real;
    constexpr auto kConvert = static_cast<decltype(flags)>(cast_flags::convert);
    if (!real.from_python(source, flags | kConvert, cleanup)) {
      return false;
    }
    value.array = std::move(real.value);
    return true;
  }
};

}  // namespace nanobind::detail
