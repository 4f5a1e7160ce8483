"""Image operations that several areas share: conversion, files, drawing, correlation, and folding into tiles."""
