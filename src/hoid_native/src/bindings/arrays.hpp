// Converts and checks the arguments and results of the bindings. An argument whose dtype or shape
// differs from that of the kernel raises a TypeError, one that fails a check a ValueError. An
// array that is not contiguous is copied.
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

#include "common/views.hpp"

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

// An array argument with dtype T (kIsReal: any real dtype, converted to T) and shape kShape (-1:
// any length). It converts to the views and pointers that kernels take.
template <typename T, bool kIsReal, int... kShape>
struct Argument
{
  using Imported = nb::ndarray<const T, Shape<kShape...>, nb::c_contig, nb::device::cpu>;

  // Number of values in a row of the array; 0 if this varies.
  static constexpr int kColumns = [](int, auto... rest) {
    return ((rest < 0) || ...) ? 0 : (1 * ... * rest);
  }(kShape...);

  Imported array;

  int size(int axis = 0) const { return static_cast<int>(array.shape(axis)); }
  int num_elements() const { return static_cast<int>(array.size()); }
  const Stored<T>* begin() const { return reinterpret_cast<const Stored<T>*>(array.data()); }
  const Stored<T>* end() const { return begin() + array.size(); }
  operator const Stored<T>*() const { return begin(); }
  operator Rows<Stored<T>, kColumns>() const
    requires(kColumns > 0)
  {
    return {begin(), size()};
  }
  operator Image<Stored<T>>() const
    requires(sizeof...(kShape) == 2)
  {
    return {begin(), size(1), size(0)};
  }
};

template <typename T, int... kShape>
using Array = Argument<T, false, kShape...>;
template <int... kShape>
using RealArray = Argument<double, true, kShape...>;
template <typename T>
using Vector = Array<T, -1>;
template <typename T>
using ImageArray = Array<T, -1, -1>;
using RealRows3 = RealArray<-1, 3>;
using Matrix = RealArray<4, 4>;
using Matrices = RealArray<-1, 4, 4>;

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

// Return the named tuple of hoid_native.results that `Tuple` names, with these fields. Vectors
// become arrays (N,).
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

// Require that each named array has `length` rows: require_lengths(3, "k", k, "j", j).
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
template <typename T, bool kIsReal, int... kShape>
void require_range(
  const char* name, const Argument<T, kIsReal, kShape...>& array, int64_t low, int64_t end)
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

template <typename Numbers>
void require_finite(const char* name, const Numbers& array)
{
  if (!std::all_of(array.begin(), array.end(), [](auto value) { return std::isfinite(value); })) {
    refuse(std::string(name) + ": not all are finite");
  }
}

// The named tuple of an aggregate that HOID_PARAMETERS declares.
template <typename Class>
struct NamedTuple;

// Require boxes of whole pixels (x1, y1, x2, y2) within an image; x2 and y2 are exclusive.
inline void require_boxes(
  const char* name, const Array<int32_t, -1, 4>& boxes, const ImageArray<float>& depth_m)
{
  const int width = depth_m.size(1), height = depth_m.size(0);
  bool inside = true;
  for (const int32_t* box = boxes.begin(); box != boxes.end(); box += 4) {
    inside &= std::min({box[0], box[1], box[2], box[3]}) >= 0 &&
              std::max(box[0], box[2]) <= width && std::max(box[1], box[3]) <= height;
  }
  if (!inside) {
    refuse(
      std::string(name) + ": a box is not within the image of " + std::to_string(width) + " x " +
      std::to_string(height) + " px");
  }
}

inline void require_pixels(const ImageArray<float>& depth_m)
{
  require(depth_m.num_elements() > 0, "depth_m: the image is empty");
}

// Each function adds the kernels of one folder to the Python module.
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

// Declares the aggregate Class as the named tuple hoid_native.parameters.NAME, an argument with
// fields of these types.
#define HOID_PARAMETERS(Class, NAME, ...)                                                 \
  template <>                                                                             \
  struct NamedTuple<Class>                                                                \
  {                                                                                       \
    using Fields = std::tuple<__VA_ARGS__>;                                               \
    static constexpr auto kName = nb::detail::const_name("hoid_native.parameters." NAME); \
  }

namespace nanobind::detail {

template <typename T, bool kIsReal, int... kShape>
struct type_caster<hoid::bindings::Argument<T, kIsReal, kShape...>>
{
  using Given = hoid::bindings::Argument<T, kIsReal, kShape...>;
  using AnyShape = ndarray<const T, hoid::bindings::Shape<kShape...>>;
  using Strided = ndarray<const T, hoid::bindings::Shape<kShape...>, device::cpu>;

  NB_TYPE_CASTER(
    Given,
    const_name<kIsReal>(
      const_name("numpy.typing.NDArray[typing.Any]"), make_caster<AnyShape>::Name))

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    constexpr auto kConvert = static_cast<decltype(flags)>(cast_flags::convert);
    make_caster<typename Given::Imported> contiguous;
    make_caster<Strided> strided;
    if (
      !contiguous.from_python(source, flags & ~kConvert, cleanup) &&
      !((kIsReal || strided.from_python(source, flags & ~kConvert, cleanup)) &&
        contiguous.from_python(source, flags | kConvert, cleanup))) {
      return false;
    }
    value.array = std::move(contiguous.value);
    return true;
  }
};

template <typename Class>
  requires requires { typename hoid::bindings::NamedTuple<Class>::Fields; }
struct type_caster<Class>
{
  using Tuple = hoid::bindings::NamedTuple<Class>;

  NB_TYPE_CASTER(Class, Tuple::kName)

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    make_caster<typename Tuple::Fields> fields;
    if (!fields.from_python(source, flags, cleanup)) {
      return false;
    }
    value = std::make_from_tuple<Class>(fields.operator typename Tuple::Fields());
    return true;
  }
};

}  // namespace nanobind::detail
