# Installs the project into an empty folder and builds a program on it that knows nothing but find_package(iris).
add_test(NAME house.package
         COMMAND ${CMAKE_COMMAND} -DBUILD_DIR=${PROJECT_BINARY_DIR} -DCONSUMER_DIR=${PROJECT_SOURCE_DIR}/tests/house/consumer
                 -DWORK_DIR=${PROJECT_BINARY_DIR}/tests/package_check -DCONFIG=$<CONFIG> -DGENERATOR=${CMAKE_GENERATOR}
                 -DCOMPILER=${CMAKE_CXX_COMPILER} -DFLAGS=${CMAKE_CXX_FLAGS} -DLAUNCHER=${CMAKE_CXX_COMPILER_LAUNCHER}
                 -P ${PROJECT_SOURCE_DIR}/tests/house/run_package_check.cmake)
set_tests_properties(house.package PROPERTIES TIMEOUT 900)
