using System;
using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// A scene as JsonUtility writes it: these fields in this order, with these names, are the file. What a scene may
    /// have besides is in SceneExtras. SI units; Unity's axes.
    /// </summary>
    [Serializable]
    public class SceneData
    {
        public int integrationMethod = 2;
        public float delta = 0.02f;
        public float tolerance = 1e-5f;
        public int optimizationIterations = 100;
        public List<ObjectData> objects = new List<ObjectData>();
        public List<ColliderData> colliders = new List<ColliderData>();
        public Vector3 windVel;
        public bool printTimes;
        public int forwardSubSteps = 1;
        public string title = "";
    }

    /// <summary>One cloth: n vertices, S springs, T triangles.</summary>
    [Serializable]
    public class ObjectData
    {
        public List<Vector3> vertPos = new List<Vector3>(); // n, m
        public List<bool> vertIsFixed = new List<bool>(); // n
        public List<float> vertMass = new List<float>(); // n, kg
        public List<int> springs = new List<int>(); // 2 S, the ends of each spring in turn
        public List<float> springStiffness = new List<float>(); // S, N/m
        public List<int> triangles = new List<int>(); // 3 T
        public float dragCoefficient;
        public float damping;
        public string optimizationSettings = "nn";
    }

    /// <summary>An obstacle.</summary>
    [Serializable]
    public class ColliderData
    {
        public int type = Obstacles.Sphere;
        public Vector3 pos; // m
        public Vector3 rot; // Euler angles, degrees
        public Vector3 scale = Vector3.one; // m
    }

    /// <summary>Numbers of the types of obstacles.</summary>
    public static class Obstacles
    {
        public const int Plane = 0, Sphere = 1, Capsule = 2, Box = 3;
    }
}
