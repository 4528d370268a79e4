from setuptools import find_packages, setup

PACKAGE = "swarmabs_fleet"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Bundles, checks and operation of fleets of real robots",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "templates/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "jinja2", "PyYAML", "psutil"],
    extras_require={
        "deploy": ["cryptography>=41"],
    },
    zip_safe=False,
)
