using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// A box that holds the vertices that are in it at the start: the unit cube of this object's transform. With keys,
    /// they move and turn with it, about its centre.
    /// </summary>
    [AddComponentMenu("Clothfit/Fixer")]
    [DisallowMultipleComponent]
    public class ClothfitFixer : MonoBehaviour
    {
        const float Half = 0.5f;

        [Tooltip("Displacement over time, m; its change since time 0 counts")]
        public TimedKeys positionKeys = new TimedKeys();

        [Tooltip("Rotation over time, Euler angles in degrees; its change since time 0 counts")]
        public TimedKeys rotationKeys = new TimedKeys();

        public bool Moves
        {
            get { return positionKeys.IsSet || rotationKeys.IsSet; }
        }

        /// <summary>Whether a place, m, in the world is in the box.</summary>
        public bool Holds(Vector3 place)
        {
            Vector3 own = transform.InverseTransformPoint(place);
            return Mathf.Abs(own.x) <= Half && Mathf.Abs(own.y) <= Half && Mathf.Abs(own.z) <= Half;
        }

        void OnDrawGizmos()
        {
            Gizmos.matrix = transform.localToWorldMatrix;
            Gizmos.color = new Color(1f, 0.6f, 0.1f, 1f);
            Gizmos.DrawWireCube(Vector3.zero, Vector3.one);
            Gizmos.matrix = Matrix4x4.identity;
        }
    }
}
