# For ROS from wheels, which has no rclcpp and only Fast DDS. To be included before rosidl_generate_interfaces().
find_package(rclcpp QUIET)
if(rclcpp_FOUND)
  return()
endif()

# Only Python nodes can use the messages: what only C++ needs is a third of the time of the build.
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# The wheels of the message packages bake the build machine's Python include path (/opt/python/cp311-cp311/...) into
# <pkg>__rosidl_generator_py. Drop absolute include directories that do not exist here,
# also those of the package that rosidl_generate_interfaces() itself finds for services.
find_package(service_msgs QUIET)
get_property(_targets DIRECTORY PROPERTY IMPORTED_TARGETS)
foreach(_target IN LISTS _targets)
  get_target_property(_folders ${_target} INTERFACE_INCLUDE_DIRECTORIES)
  if(_folders)
    set(_present "")
    foreach(_folder IN LISTS _folders)
      if(NOT IS_ABSOLUTE "${_folder}" OR EXISTS "${_folder}")
        list(APPEND _present "${_folder}")
      endif()
    endforeach()
    set_property(TARGET ${_target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES ${_present})
  endif()
endforeach()
